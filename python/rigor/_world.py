"""Worlds: what stands where, and what it is like."""
from __future__ import annotations

import os

import numpy

from . import _display, _rigor
from ._errors import BadInput


class Node:
    """One node of a world: `node["height_m"]`, `node["height_m"] = 12.5` (a transaction; the world's rules may refuse it)."""

    def __init__(self, world: "World", node: int):
        self._world, self.id = world, int(node)

    @property
    def type(self) -> str:
        return self._world._world.type_of(self.id)

    @property
    def values(self) -> dict:
        """All attributes by name: numbers, text, arrays; poses as 4 x 4 matrices T_parent_node."""
        return self._world._world.values(self.id)

    def __getitem__(self, name: str):
        return self._world._world.get(self.id, name)

    def __setitem__(self, name: str, value) -> None:
        self._world._world.set(self.id, name, value)

    @property
    def T_world_node(self) -> numpy.ndarray:
        """4 x 4, metres; z NaN: on the terrain, without a height of its own."""
        return self._world._world.T_world_node(self.id)

    def __repr__(self) -> str:
        return f"<{self.type} {self.id}>"


class Nodes:
    """Nodes that a query found: `len`, `[i]`, iteration (Node), `ids`; `["height_m"]` has that attribute of all, (n,) or (n, 3)."""

    def __init__(self, world: "World", ids: numpy.ndarray):
        self._world, self.ids = world, ids

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, key):
        if isinstance(key, str):
            return self._world._world.column(self.ids, key)
        if isinstance(key, (int, numpy.integer)):
            return Node(self._world, self.ids[key])
        return Nodes(self._world, self.ids[key])

    def __iter__(self):
        return (Node(self._world, i) for i in self.ids)

    def __repr__(self) -> str:
        return f"<{len(self)} nodes>"

    def _repr_html_(self) -> str:
        return _display.table_html(["id", "type"], [[n.id, n.type] for n in self[:20]])


class World:
    """A world file, a world in YAML, or an import plan, which is imported into memory.

        trees = rigor.World("forest.import.yaml").query(type="Tree", within=(0, 0, 20))
        trees["dbh_m"].mean(); trees[0].T_world_node

    Coordinates are the world's: metres, x east, y north, z up. What is written is written in memory.
    """

    def __init__(self, world):
        self._world = _rigor.World(os.fspath(world))
        self.path, self.warnings = os.fspath(world), self._world.warnings

    def query(self, type: str = "Object", *, within=None, box=None, nearest=None, count: int = 1) -> Nodes:
        """Nodes of a type and its subtypes.

        within=(x, y, radius) or (x, y, z, radius): no further from there, nearest first; without z the distance is level.
        box=((x, y, z), (x, y, z)): in it. nearest=(x, y, z) and count: so many. Without any: all. What stands on the terrain without
        a height of its own (z NaN, as trees of an import) is found by the level distance alone.
        """
        if sum(q is not None for q in (within, box, nearest)) > 1:
            raise BadInput("query", "expected one of within, box and nearest")
        w = self._world
        if within is not None:
            if len(within) not in (3, 4):
                raise BadInput("within", f"expected (x, y, radius) or (x, y, z, radius) in metres, got {within!r}")
            if len(within) == 4:
                return Nodes(self, w.in_radius(type, numpy.array(within[:3], float), float(within[3])))
            return self._level(type, *map(float, within))
        if box is not None:
            low, high = numpy.array(box, float)
            return Nodes(self, w.in_box(type, low, high))
        if nearest is not None:
            return Nodes(self, w.nearest(type, numpy.array(nearest, float), int(count)))
        return Nodes(self, w.nodes(type))

    def _level(self, type: str, x: float, y: float, radius: float) -> Nodes:
        # Not by the index: what stands on the terrain without a height of its own lies in no box.
        ids = self._world.nodes(type)
        places = numpy.array([self._world.T_world_node(int(i))[:2, 3] for i in ids]).reshape(-1, 2)
        distance = numpy.hypot(places[:, 0] - x, places[:, 1] - y)
        keep = distance <= radius
        return Nodes(self, ids[keep][numpy.argsort(distance[keep], kind="stable")])

    def __getitem__(self, node: int) -> Node:
        self._world.type_of(int(node))
        return Node(self, node)

    def __len__(self) -> int:
        return self._world.node_count

    @property
    def types(self) -> dict[str, dict]:
        """Types by name: base, count (with subtypes), meaning, abstract."""
        return {n: dict(zip(("base", "count", "meaning", "abstract"), t)) for n, t in self._world.types().items()}

    def attributes(self, type: str) -> dict[str, dict]:
        """Attributes of a type by name: kind, unit, meaning."""
        return {n: dict(zip(("kind", "unit", "meaning"), a)) for n, a in self._world.attributes(type).items()}

    def __repr__(self) -> str:
        return f"<world {self.path}: {len(self)} nodes>"

    def _repr_html_(self) -> str:
        rows = [[n, t["count"], t["meaning"]] for n, t in self.types.items() if t["count"]]
        return _display.table_html(["type", "nodes", "meaning"], rows)
