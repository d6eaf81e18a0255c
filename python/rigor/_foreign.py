"""From messages of ROS 2 to samples and arrays, with the names and units that Rigor's samples have."""
from __future__ import annotations

import numpy

from ._errors import BadInput
from ._samples import POINT, Sample

_KINDS = {"sensor_msgs/Image": "image", "sensor_msgs/PointCloud2": "point_cloud", "can_msgs/Frame": "can_frame",
          "rigor_msgs/RegisterBlock": "registers", "geometry_msgs/PoseStamped": "pose", "rigor_msgs/Event": "event",
          "sensor_msgs/Imu": "imu", "sensor_msgs/NavSatFix": "nav_fix", "nav_msgs/Odometry": "odometry"}
# Encoding of sensor_msgs/Image: NumPy's type, values a pixel, name by PFNC where there is one.
_ENCODINGS = {"mono8": ("u1", 1, "Mono8"), "8UC1": ("u1", 1, "Mono8"), "mono16": ("u2", 1, "Mono16"), "16UC1": ("u2", 1, ""),
              "rgb8": ("u1", 3, "RGB8"), "bgr8": ("u1", 3, ""), "rgba8": ("u1", 4, ""), "bgra8": ("u1", 4, ""),
              "rgb16": ("u2", 3, ""), "bgr16": ("u2", 3, ""), "8UC3": ("u1", 3, ""), "8UC4": ("u1", 4, ""), "16SC1": ("i2", 1, ""),
              "32SC1": ("i4", 1, ""), "32FC1": ("f4", 1, ""), "64FC1": ("f8", 1, ""), "yuv422": ("u1", 2, ""),
              "yuv422_yuy2": ("u1", 2, "YUV422_8")}
_ENCODINGS |= {f"bayer_{p}8": ("u1", 1, "BayerRG8" if p == "rggb" else "") for p in ("rggb", "bggr", "gbrg", "grbg")}
_ENCODINGS |= {f"bayer_{p}16": ("u2", 1, "BayerRG16" if p == "rggb" else "") for p in ("rggb", "bggr", "gbrg", "grbg")}
_POINT_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_POINT_NAMES = ["x", "y", "z", "intensity", "t_offset_ns", "ring", "return_index", "flags"]
_FIX = ("none", "fix", "sbas", "rtk_float", "rtk_fixed")


def _short(name: str) -> str:
    parts = name.split("/")
    return f"{parts[0]}/{parts[-1]}"


def kind_of(type_name: str, companions) -> str:
    """Rigor's name for what such messages are; the type itself where it has none."""
    if _short(type_name) == "sensor_msgs/Image" and "settings" not in companions and "stamp" in companions:
        return "range_image"
    return _KINDS.get(_short(type_name), type_name)


def pixels(message) -> numpy.ndarray:
    """(height, width[, values]) of a sensor_msgs/Image, without a copy; bytes where the encoding is of no plain numbers."""
    code, each, _ = _ENCODINGS.get(message.encoding, (None, 0, ""))
    if code is None:
        return message.data
    order = ">" if message.is_bigendian else "<"
    dtype = numpy.dtype(order + code)
    step = message.step or message.width * each * dtype.itemsize
    if step < message.width * each * dtype.itemsize or step * message.height > len(message.data):
        raise BadInput("sensor_msgs/Image", f"expected {message.height} rows of {step} bytes, got {len(message.data)} bytes")
    shape = (message.height, message.width) + ((each,) if each > 1 else ())
    strides = (step, each * dtype.itemsize) + ((dtype.itemsize,) if each > 1 else ())
    return numpy.ndarray(shape, dtype, message.data, 0, strides)


def points(message) -> numpy.ndarray:
    """(n,) of a sensor_msgs/PointCloud2, a structured array, without a copy: type POINT where Rigor wrote it."""
    n, step = message.width * message.height, message.point_step
    if n * step > len(message.data):
        raise BadInput("sensor_msgs/PointCloud2", f"expected {n} points of {step} bytes, got {len(message.data)} bytes")
    if step == POINT.itemsize and [f.name for f in message.fields] == _POINT_NAMES:
        return numpy.frombuffer(message.data, POINT, n)
    order = ">" if message.is_bigendian else "<"
    formats = [((order + _POINT_TYPES[f.datatype], (f.count,)) if f.count > 1 else order + _POINT_TYPES[f.datatype])
               for f in message.fields]
    dtype = numpy.dtype({"names": [f.name for f in message.fields], "formats": formats,
                         "offsets": [f.offset for f in message.fields], "itemsize": step})
    return numpy.frombuffer(message.data, dtype, n)


class RecordedSample(Sample):
    """A sample of a recording; `message` is what the file has of it. Arrays point into the file."""

    def array(self) -> numpy.ndarray:
        kind = _short(self.message._type)
        if self.kind == "range_image":
            planes = [pixels(self.message)]
            planes.append(pixels(self.amplitude) if self.amplitude is not None else numpy.zeros_like(planes[0]))
            return numpy.stack(planes)
        if kind == "sensor_msgs/Image":
            return pixels(self.message)
        if kind == "sensor_msgs/PointCloud2":
            return points(self.message)
        if kind == "sensor_msgs/LaserScan":
            return self.message.ranges
        raise TypeError(f"expected a picture, a scan or a cloud, got a sample of kind {self.kind}; its values are attributes, "
                        "and the channel's array() has those of all samples")

    @property
    def range_m(self) -> numpy.ndarray:
        """Of a range image: (height, width) float32, metres along the ray, NaN: no return. Without a copy."""
        return pixels(self.message)


def sample(channel, i: int) -> Sample:
    """Sample i of a channel."""
    main = channel._main
    message = main[i]
    stamp = channel._companion("stamp", i)
    if stamp is not None:
        head = (stamp.sequence, stamp.t_capture_ns, stamp.t_release_ns, stamp.t_arrival_ns, stamp.sigma_capture_ns,
                stamp.lost_before, stamp.validity)
    else:
        log = int(main.times[i])
        header = getattr(message, "header", None)
        capture = header.stamp.sec * 10**9 + header.stamp.nanosec if header is not None else log
        head = (i, capture, log, log, 0, 0, 0)
    s = RecordedSample(channel.kind, head, getattr(message, "data", None))
    s.message = message
    fill = _FILL.get(channel.kind)
    if fill:
        fill(s, message, channel, i)
    return s


def _fill_image(s, m, channel, i):
    s.width_px, s.height_px = m.width, m.height
    settings = channel._companion("settings", i)
    s.format = settings.pixel_format if settings else _ENCODINGS.get(m.encoding, ("", 0, ""))[2] or m.encoding
    if settings:
        s.offset_x_px, s.offset_y_px = settings.offset_x_px, settings.offset_y_px
        s.exposure_ns, s.gain_db = settings.exposure_ns, settings.gain_db


def _fill_range(s, m, channel, i):
    s.width_px, s.height_px, s.amplitude = m.width, m.height, channel._companion("amplitude", i)


def _fill_points(s, m, channel, i):
    s.count = m.width * m.height


def _fill_registers(s, m, channel, i):
    s.values = dict(zip(m.names, m.values.tolist()))


def _xyz(v):
    return (v.x, v.y, v.z)


def _wxyz(q):
    return (q.w, q.x, q.y, q.z)


def _fill_pose(s, m, channel, i):
    s.position_m, s.orientation_wxyz = _xyz(m.pose.position), _wxyz(m.pose.orientation)


def _fill_imu(s, m, channel, i):
    s.specific_force_mps2, s.angular_rate_radps = _xyz(m.linear_acceleration), _xyz(m.angular_velocity)
    temperature = channel._companion("temperature", i)
    s.temperature_c = temperature.temperature if temperature else float("nan")


def _fill_fix(s, m, channel, i):
    quality = channel._companion("quality", i)
    s.status = _FIX[quality.status] if quality and quality.status < len(_FIX) else ("none", "fix", "sbas", "fix")[
        min(m.status.status + 1, 3) if m.status.status >= -1 else 0]
    s.satellites = quality.satellites if quality else 0
    s.latitude_deg, s.longitude_deg, s.height_m = m.latitude, m.longitude, m.altitude
    s.covariance_enu_m2 = tuple(m.position_covariance.tolist())


def _fill_odometry(s, m, channel, i):
    s.position_m, s.orientation_wxyz = _xyz(m.pose.pose.position), _wxyz(m.pose.pose.orientation)
    s.velocity_mps, s.turn_rate_radps = _xyz(m.twist.twist.linear), _xyz(m.twist.twist.angular)
    s.pose_variance = tuple(m.pose.covariance[::7].tolist())
    s.twist_variance = tuple(m.twist.covariance[::7].tolist())
    wheels = channel._companion("wheels", i)
    if wheels:
        s.wheel_angle_rad, s.wheel_rate_radps = tuple(wheels.position.tolist()), tuple(wheels.velocity.tolist())


def _fill_can(s, m, channel, i):
    s.id, s.extended, s.remote, s.error, s.fd = m.id, m.is_extended, m.is_rtr, m.is_error, False
    s.data = bytes(m.data[:m.dlc])


_FILL = {"image": _fill_image, "range_image": _fill_range, "point_cloud": _fill_points, "registers": _fill_registers,
         "pose": _fill_pose, "imu": _fill_imu, "nav_fix": _fill_fix, "odometry": _fill_odometry, "can_frame": _fill_can}

# Columns of what is a few numbers: name, count, fields of the message (of a companion: COMPANION:field).
_POSE = "{0}position.x {0}position.y {0}position.z", "{0}orientation.w {0}orientation.x {0}orientation.y {0}orientation.z"
_COLUMNS = {
    "imu": [("specific_force_mps2", "linear_acceleration.x linear_acceleration.y linear_acceleration.z"),
            ("angular_rate_radps", "angular_velocity.x angular_velocity.y angular_velocity.z"),
            ("temperature_c", "temperature:temperature")],
    "pose": [("position_m", _POSE[0].format("pose.")), ("orientation_wxyz", _POSE[1].format("pose."))],
    "nav_fix": [("latitude_deg", "latitude"), ("longitude_deg", "longitude"), ("height_m", "altitude"),
                ("covariance_enu_m2", "position_covariance"), ("status", "quality:status"),
                ("satellites", "quality:satellites")],
    "odometry": [("position_m", _POSE[0].format("pose.pose.")), ("orientation_wxyz", _POSE[1].format("pose.pose.")),
                 ("velocity_mps", "twist.twist.linear.x twist.twist.linear.y twist.twist.linear.z"),
                 ("turn_rate_radps", "twist.twist.angular.x twist.twist.angular.y twist.twist.angular.z"),
                 ("wheel_angle_rad", "wheels:position"), ("wheel_rate_radps", "wheels:velocity")],
}


def _table(columns: list[tuple[str, numpy.ndarray]], n: int) -> numpy.ndarray:
    dtype = [(name, c.dtype.newbyteorder("="), c.shape[1:]) for name, c in columns]
    out = numpy.empty(n, dtype)
    for name, c in columns:
        out[name] = c
    return out


def _numbers(channel) -> numpy.ndarray:
    columns, index = [], channel._index
    for name, paths in _COLUMNS[channel.kind]:
        topic = channel._main
        if ":" in paths:
            companion, paths = paths.split(":")
            topic = channel._companions.get(companion)
            if topic is None or len(topic) != len(channel._main):
                continue
        parts = topic.columns(paths.split(), index)
        columns.append((name, parts[0] if len(parts) == 1 else numpy.stack(parts, axis=-1)))
    return _table(columns, len(index))


def _registers(channel) -> numpy.ndarray:
    names = channel._main[channel._index[0]].names
    values, = channel._main.columns(["values"], channel._index)
    return _table([(name, values[:, i]) for i, name in enumerate(names)], len(values))


def _generic(channel) -> numpy.ndarray:
    """Every number of a message of any type, by its path with dots."""
    layout = channel._main.definition.layout(channel._main.data(channel._index[0]))
    paths = list(layout.numbers)
    return _table(list(zip(paths, channel._main.columns(paths, channel._index))), len(channel))


def _reshaped(rows: numpy.ndarray, shape: numpy.ndarray) -> numpy.ndarray:
    """Bytes of pictures (n, bytes), parts of longer rows, as pictures like `shape`: (n, *shape). Without a copy."""
    view = numpy.lib.stride_tricks.as_strided
    return view(rows[:, :shape.itemsize].view(shape.dtype), (len(rows), *shape.shape), (rows.strides[0], *shape.strides))


def stack_pictures(topic, index: range) -> numpy.ndarray:
    """(n, height, width[, values]) of sensor_msgs/Image messages; one copy."""
    first = topic[index[0]]
    shape = pixels(first)
    if shape.ndim == 1:
        raise BadInput(topic.topic, f"expected pixels of plain numbers, got the encoding {first.encoding}: [i].array() has the bytes")
    if shape.flags.c_contiguous:
        size, data = topic.columns(["height", "width", "step"], index), None
        if all((s == s[0]).all() for s in size):
            data, = topic.columns(["data"], index)
        if data is not None and data.ndim == 2:
            return _reshaped(data, shape)
    out = numpy.empty((len(index), *shape.shape), shape.dtype)
    for k, i in enumerate(index):
        picture = pixels(topic[i])
        if picture.shape != shape.shape:
            raise BadInput(topic.topic, f"expected pictures of one size, {shape.shape}, got {picture.shape} in message {i}; "
                           "go through the channel instead")
        out[k] = picture
    return out


def stack(channel) -> numpy.ndarray:
    """Channel.array()."""
    if not len(channel):
        raise BadInput(channel.name, "expected samples, the channel has none here")
    kind = channel.kind
    if kind in ("image", "range_image"):
        return stack_pictures(channel._main, channel._index)
    if kind == "point_cloud":
        clouds = [s.array() for s in channel]
        dtype = numpy.dtype([("sample", "<u4")] + [(n, clouds[0].dtype[n]) for n in clouds[0].dtype.names])
        out = numpy.empty(sum(map(len, clouds)), dtype)
        at = 0
        for k, cloud in enumerate(clouds):
            part = out[at:at + len(cloud)]
            part["sample"] = k
            for name in cloud.dtype.names:
                part[name] = cloud[name]
            at += len(cloud)
        return out
    if kind in _COLUMNS:
        return _numbers(channel)
    if kind == "registers":
        return _registers(channel)
    return _generic(channel)


def header_times(topic, index: range, log: numpy.ndarray) -> numpy.ndarray:
    """Captures in UTC from the headers of messages; the log times where they have none."""
    if not hasattr(topic[index[0]], "header"):
        return log
    sec, nanosec = topic.columns(["header.stamp.sec", "header.stamp.nanosec"], index)
    return sec.astype("i8") * 10**9 + nanosec
