"""Worlds: queries and attributes."""
import unittest

import numpy
import rigor
from rigs import CONFIGS


class Worlds(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.world = rigor.World(CONFIGS / "worlds/harvester-stand.yaml")

    def test_queries_find_what_lies_there(self):
        trees = self.world.query(type="Tree")
        self.assertEqual(len(trees), self.world.types["Tree"]["count"])
        self.assertGreater(len(trees), 50)
        places = trees["position"]
        self.assertEqual(places.shape, (len(trees), 3))
        near = self.world.query(type="Tree", within=(0, 0, 10))
        level = numpy.hypot(places[:, 0], places[:, 1])
        self.assertEqual(set(near.ids.tolist()), set(trees.ids[level <= 10].tolist()))
        distances = numpy.hypot(*near["position"][:, :2].T)
        self.assertTrue((numpy.diff(distances) >= 0).all())
        self.assertEqual(self.world.query(type="Tree", nearest=(0, 0, 0)).ids[0], near.ids[0])
        self.assertEqual(len(self.world.query(type="Tree", box=((-5, -5, -9), (5, 5, 9)))),
                         int(((numpy.abs(places[:, 0]) <= 5) & (numpy.abs(places[:, 1]) <= 5)).sum()))

    def test_trees_on_a_terrain_are_found_by_their_level_distance(self):
        trees = rigor.World(CONFIGS / "worlds/forest.import.yaml").query(type="Tree")
        places = trees["position"]
        self.assertTrue(numpy.isnan(places[:, 2]).any())
        near = trees._world.query(type="Tree", within=(0, 0, 20))
        self.assertEqual(len(near), int((numpy.hypot(places[:, 0], places[:, 1]) <= 20).sum()))
        self.assertGreater(len(near), 10)

    def test_nodes_have_values_and_places(self):
        tree = self.world.query(type="Tree")[0]
        self.assertEqual(tree.type, "Tree")
        self.assertEqual(tree["dbh_m"], tree.values["dbh_m"])
        numpy.testing.assert_allclose(tree.T_world_node[:3, 3], tree["position"])
        self.assertEqual(self.world.attributes("Tree")["dbh_m"]["kind"], "number")

    def test_what_is_written_is_there_and_may_be_refused(self):
        world = rigor.World(CONFIGS / "worlds/harvester-stand.yaml")
        tree = world.query(type="Tree")[0]
        tree["dbh_m"] = 0.5
        self.assertEqual(world[tree.id]["dbh_m"], 0.5)
        with self.assertRaises(rigor.BadInput):
            tree["dbh_m"] = -3.0
        self.assertEqual(tree["dbh_m"], 0.5)

    def test_names_are_offered(self):
        with self.assertRaisesRegex(rigor.BadInput, "did you mean Tree"):
            self.world.query(type="Tre")
        with self.assertRaisesRegex(rigor.BadInput, "attribute of Tree"):
            self.world.query(type="Tree")["dbh"]
        with self.assertRaises(rigor.BadInput):
            self.world[10**9]
        with self.assertRaises(rigor.NotFound):
            rigor.World("no-such.yaml")


if __name__ == "__main__":
    unittest.main()
