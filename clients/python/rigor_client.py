"""An application of a Rigor rig as a Python program: sees the rig's channels, gives commands.

    import rigor_client

    class Detector(rigor_client.Application):
        rate_hz = 50                                      # turns; a rig's own `rate_hz` goes before

        def start(self, rig):                             # once: parameters, inputs and outputs are known
            self.limit = rig.params.get("limit", 200)

        def step(self, turn):                             # each turn
            camera = turn["left"]
            if camera.fresh and camera.sample.array().max() > self.limit:
                turn.command("table_command", enable=1, target_rate=10.0)

    rigor_client.run(Detector())

The rig names the program: `application: { command: [python3, detector.py] }`. NumPy is needed for `array()` alone.
Arrays and memory views of samples are valid until the next turn begins; copy what is to be kept. What is raised in
`step` ends the run, with the exception as the reason. The protocol is that of docs/application-protocol.md, version 1.
"""
import json
import mmap
import os
import socket
import struct
import sys
import traceback

PROTOCOL = 1
_HELLO, _SETUP, _READY, _TURN, _COMMANDS, _FINISH, _DONE, _FAILED = range(1, 9)
_HEADER = struct.Struct("<II")
_TURN_HEAD = struct.Struct("<QqII")
_SAMPLE_HEAD = struct.Struct("<IIQqqqqIIQQII")
_KINDS = ("none", "image", "range_image", "point_cloud", "can_frame", "registers", "pose", "event", "imu", "nav_fix",
          "odometry")
_STATUS = ("never", "fresh", "held", "overdue", "disconnected")
_FIX = ("none", "fix", "sbas", "rtk_float", "rtk_fixed")
_LARGEST = 16 << 20
_LARGEST_ERROR = 32 << 10

# Bits of Sample.validity; 0 is a good one.
INCOMPLETE, SATURATED, CLOCK_UNSURE, CORRUPT, SUBSTITUTED = (1 << bit for bit in range(5))

# NumPy's type of a pixel, and how many of them a pixel has; other formats are bytes.
_PIXELS = {"Mono8": ("u1", 1), "BayerRG8": ("u1", 1), "RGB8": ("u1", 3), "YUV422_8": ("u1", 2), "Mono10": ("<u2", 1),
           "Mono12": ("<u2", 1), "Mono16": ("<u2", 1), "BayerRG10": ("<u2", 1), "BayerRG12": ("<u2", 1),
           "BayerRG16": ("<u2", 1), "Coord3D_C16": ("<u2", 1)}
POINT = [("x_m", "<f4"), ("y_m", "<f4"), ("z_m", "<f4"), ("remission", "<f4"), ("t_offset_ns", "<i4"), ("ring", "<u2"),
         ("return_index", "u1"), ("flags", "u1")]


class Failed(Exception):
    """Raised where the bench breaks the connection or the protocol, or a command is not one."""


class Sample:
    """One sample of a channel.

    sequence, t_capture_ns, t_release_ns, t_arrival_ns, sigma_capture_ns (bench clock), lost_before, validity; `kind`;
    and by kind:
      image        width_px, height_px, offset_x_px, offset_y_px, exposure_ns, gain_db, format
      range_image  width_px, height_px
      point_cloud  count
      can_frame    id, extended, remote, error, fd, bit_rate_switch, data (bytes)
      registers    values: by their names, in the units of the port
      pose         position_m (x, y, z), orientation_wxyz: T_parent_child
      event        code, value, text
      imu          specific_force_mps2, angular_rate_radps, temperature_c
      nav_fix      status, satellites, latitude_deg, longitude_deg, height_m, covariance_enu_m2 (9, row by row)
      odometry     position_m, orientation_wxyz (T_odom_base), velocity_mps, turn_rate_radps, pose_variance,
                   twist_variance, wheel_angle_rad, wheel_rate_radps
    """

    def __init__(self, kind, head, data):
        self.kind = kind
        (self.sequence, self.t_capture_ns, self.t_release_ns, self.t_arrival_ns, self.sigma_capture_ns,
         self.lost_before, self.validity) = head
        self.bytes = data

    def array(self):
        """The pixels (height, width[, values]), the two planes range [m] and amplitude (2, height, width) of a range
        image (NaN: no return), or the points of a cloud as a structured array (POINT). Without a copy, read-only."""
        import numpy  # only here: a program without pictures needs none
        if self.kind == "image":
            if self.format not in _PIXELS:
                return numpy.frombuffer(self.bytes, "u1")
            dtype, each = _PIXELS[self.format]
            shape = (self.height_px, self.width_px) + ((each,) if each > 1 else ())
            return numpy.frombuffer(self.bytes, dtype).reshape(shape)
        if self.kind == "range_image":
            return numpy.frombuffer(self.bytes, "<f4").reshape(2, self.height_px, self.width_px)
        if self.kind == "point_cloud":
            return numpy.frombuffer(self.bytes, POINT)
        raise TypeError(f"expected a picture or a cloud, got a sample of kind {self.kind}")

    def __repr__(self):
        return f"<{self.kind} {self.sequence} captured at {self.t_capture_ns * 1e-9:.6f} s>"


def _read_info(sample, port, info):
    kind = sample.kind
    if kind == "image":
        (sample.width_px, sample.height_px, sample.offset_x_px, sample.offset_y_px, sample.exposure_ns, sample.gain_db,
         name) = struct.unpack_from("<IIIIqd32s", info)
        sample.format = name.rstrip(b"\0").decode()
    elif kind == "range_image":
        sample.width_px, sample.height_px = struct.unpack_from("<II", info)
    elif kind == "point_cloud":
        sample.count, size = struct.unpack_from("<II", info)
        if size != 24:
            raise Failed(f"expected points of 24 bytes, got {size}")
    elif kind == "can_frame":
        sample.id, flags, length = struct.unpack_from("<IBB", info)
        sample.extended, sample.remote, sample.error, sample.fd, sample.bit_rate_switch = (
            bool(flags >> bit & 1) for bit in range(5))
        sample.data = bytes(info[8:8 + length])
    elif kind == "registers":
        count, _ = struct.unpack_from("<II", info)
        values = struct.unpack_from(f"<{count}d", info, 8)
        sample.values = dict(zip(port.names, values))
    elif kind == "pose":
        v = struct.unpack_from("<7d", info)
        sample.position_m, sample.orientation_wxyz = v[:3], v[3:]
    elif kind == "event":
        sample.code, _, sample.value = struct.unpack_from("<IId", info)
        sample.text = bytes(info[16:]).split(b"\0")[0].decode(errors="replace")
    elif kind == "imu":
        v = struct.unpack_from("<7d", info)
        sample.specific_force_mps2, sample.angular_rate_radps, sample.temperature_c = v[:3], v[3:6], v[6]
    elif kind == "nav_fix":
        status, sample.satellites, *v = struct.unpack_from("<II12d", info)
        sample.status = _FIX[status]
        sample.latitude_deg, sample.longitude_deg, sample.height_m = v[:3]
        sample.covariance_enu_m2 = tuple(v[3:])
    elif kind == "odometry":
        v = struct.unpack_from("<29d", info)
        sample.position_m, sample.orientation_wxyz, sample.velocity_mps = v[:3], v[3:7], v[7:10]
        sample.turn_rate_radps, sample.pose_variance, sample.twist_variance = v[10:13], v[13:19], v[19:25]
        sample.wheel_angle_rad, sample.wheel_rate_radps = v[25:27], v[27:29]


class Port:
    """A channel as the application sees it: name, kind, rate_hz, latency_ms, frame_id, width_px, height_px, names and
    units of its values; `status` (never, fresh, held, overdue, disconnected); `sample`, the newest (None before the first);
    `samples`, those since the turn before (of pictures and clouds the newest alone); `fresh`: there are some."""

    def __init__(self, description):
        self.rate_hz = self.latency_ms = 0.0
        self.format = ""
        self.__dict__.update(description)
        self.status, self.sample, self.samples = "never", None, []

    @property
    def fresh(self):
        return bool(self.samples)

    def __repr__(self):
        return f"<port {self.name}: {self.kind}, {self.status}>"


class Rig:
    """What is known before the first turn: rig (its name), clock (`wall` or `virtual`), seed, loop_rate_hz,
    duration_s (0: no end), params (a dict), inputs and outputs (dicts by name)."""

    def __init__(self, setup):
        self.rig, self.clock, self.seed = setup["rig"], setup["clock"], setup["seed"]
        self.loop_rate_hz, self.duration_s, self.params = setup["loop_rate_hz"], setup["duration_s"], setup["params"]
        self.inputs = {d["name"]: Port(d) for d in setup["inputs"]}
        self.outputs = {d["name"]: d for d in setup["outputs"]}


class Turn:
    """One call of the application: `cycle` of the loop, `t_ns` on the bench clock; `turn[name]` is a Port."""

    def __init__(self, rig):
        self._rig = rig
        self._outputs = {name: (i, d["names"]) for i, (name, d) in enumerate(rig.outputs.items())}
        self.cycle, self.t_ns, self._commands = 0, 0, []

    def __getitem__(self, name):
        try:
            return self._rig.inputs[name]
        except KeyError:
            raise KeyError(f"expected one of the inputs {', '.join(self._rig.inputs)}, got {name}") from None

    def command(self, output, *values, **named):
        """Gives a command: every value of the output by name, or all in their order."""
        if output not in self._outputs:
            raise Failed(f"expected one of the outputs {', '.join(self._outputs) or '(none)'}, got {output}")
        index, names = self._outputs[output]
        if named:
            if values or set(named) != set(names):
                raise Failed(f"{output}: expected the values {', '.join(names)}, got {', '.join(named)}")
            values = [named[n] for n in names]
        elif len(values) != len(names):
            raise Failed(f"{output}: expected {len(names)} values ({', '.join(names)}), got {len(values)}")
        self._commands.append(struct.pack(f"<II{len(names)}d", index, len(names), *values))


class Application:
    """What `run` calls; derive from it."""
    rate_hz = None  # turns in a second; None: every cycle of the loop, or what the rig says

    def start(self, rig):
        """Before the first turn. What is raised here refuses the rig."""

    def step(self, turn):
        """Each turn."""

    def finish(self):
        """After the last turn."""


class _Connection:
    def __init__(self, path):
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.connect(path)

    def _read(self, size):
        data = bytearray(size)
        view, got = memoryview(data), 0
        while got < size:
            n = self._socket.recv_into(view[got:])
            if n == 0:
                raise Failed("the bench has closed the connection")
            got += n
        return memoryview(data)

    def receive(self):
        size, kind = _HEADER.unpack(self._read(_HEADER.size))
        if size > _LARGEST:
            raise Failed(f"expected a message of at most {_LARGEST} bytes, got one of {size}")
        return kind, self._read(size)

    def send(self, kind, body):
        self._socket.sendall(_HEADER.pack(len(body), kind) + body)

    def send_json(self, kind, value):
        self.send(kind, json.dumps(value).encode())

    def expect_json(self, wanted):
        kind, body = self.receive()
        if kind != wanted:
            raise Failed(f"expected message {wanted}, got {kind}")
        return json.loads(bytes(body))


class _Memory:
    """The bench's samples; mapped as far as they are needed."""

    def __init__(self, path):
        self._fd = os.open(path, os.O_RDONLY)
        self._map, self._size = None, 0

    def view(self, offset, size):
        if size == 0:
            return memoryview(b"")
        if offset + size > self._size:
            self._size = (offset + size + (1 << 28) - 1) >> 28 << 28
            self._map = memoryview(mmap.mmap(self._fd, self._size, prot=mmap.PROT_READ))
        return self._map[offset:offset + size]


def _take_turn(rig, turn, ports, memory, body):
    turn.cycle, turn.t_ns, n_ports, n_samples = _TURN_HEAD.unpack_from(body)
    at = _TURN_HEAD.size
    for port, status in zip(ports, struct.unpack_from(f"<{n_ports}I", body, at)):
        port.status = _STATUS[status]
        port.samples = []
    at += (n_ports + 1) // 2 * 8
    for _ in range(n_samples):
        index, kind, *head, offset, size, info_bytes, _ = _SAMPLE_HEAD.unpack_from(body, at)
        at += _SAMPLE_HEAD.size
        port = ports[index]
        sample = Sample(_KINDS[kind], head, memory.view(offset, size))
        _read_info(sample, port, body[at:at + info_bytes])
        at += (info_bytes + 7) // 8 * 8
        port.samples.append(sample)
        port.sample = sample
    turn._commands.clear()


def run(application):
    """Connects to the bench that started this program, and serves it until the run is over. Returns then."""
    path = os.environ.get("RIGOR_SOCKET")
    if not path:
        sys.exit("RIGOR_SOCKET is not set: this program is started by a rig, with "
                 "application: { command: [python3, " + os.path.basename(sys.argv[0]) + "] }")
    bench = _Connection(path)
    bench.send_json(_HELLO, {"protocol": PROTOCOL, "client": "python"})
    try:
        setup = bench.expect_json(_SETUP)
        rig = Rig(setup)
        memory = _Memory(setup["memory"])
        application.start(rig)
        bench.send_json(_READY, {} if application.rate_hz is None else {"rate_hz": application.rate_hz})
        turn, ports = Turn(rig), list(rig.inputs.values())
        while True:
            kind, body = bench.receive()
            if kind == _FINISH:
                break
            if kind != _TURN:
                raise Failed(f"expected a turn or the end, got message {kind}")
            _take_turn(rig, turn, ports, memory, body)
            application.step(turn)
            bench.send(_COMMANDS, struct.pack("<QII", turn.cycle, len(turn._commands), 0) + b"".join(turn._commands))
        application.finish()
        bench.send_json(_DONE, {})
    except BaseException as error:
        traceback.print_exc()
        try:
            text = f"{type(error).__name__}: {error}"
            bench.send_json(_FAILED, {"error": text[:_LARGEST_ERROR]})
        except OSError:
            pass  # the bench is gone; that is what happened
        sys.exit(1)
