#!/usr/bin/env python3
"""Writes the small bags of the tests in src/formats/ros/tests.rs into this folder.

    pip install rosbags==0.11.9 mcap==1.6.0 lz4 zstandard
    python make.py

Every bag has 80 messages of each topic (the MCAP files have 40 each, in sequence), 10 ms apart:
/imu/data with orientation, /front/imu without angular velocity and orientation, /imu/mag, /imu/temperature.
"""

from pathlib import Path

import numpy
from mcap.writer import CompressionType, Writer as McapWriter
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

HERE = Path(__file__).parent
START_NS = 1_700_000_000_000_000_000
COUNT = 80
IDL = {
    "sensor_msgs/msg/Imu": "module sensor_msgs { module msg { struct Imu { std_msgs::msg::Header header; }; }; };",
}


def messages(store, k):
    """Topic and message number k of each."""
    t = store.types
    stamp_ns = START_NS + 10_000_000 * k
    stamp = t["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    header = {"stamp": stamp, "frame_id": "imu" + "_" * (k % 7)}
    if "seq" in t["std_msgs/msg/Header"].__dataclass_fields__:
        header["seq"] = k
    header = t["std_msgs/msg/Header"](**header)
    vector = t["geometry_msgs/msg/Vector3"]
    none, known = numpy.array([-1.0] + 8 * [0.0]), numpy.zeros(9)
    quaternion = t["geometry_msgs/msg/Quaternion"]
    imu = t["sensor_msgs/msg/Imu"]
    force = vector(x=0.125 * k, y=-0.5, z=9.75)
    rate = vector(x=0.25, y=-0.0625 * k, z=0.5)
    unit, zero = quaternion(x=0.6, y=0.0, z=0.0, w=0.8), vector(x=0.0, y=0.0, z=0.0)
    yield "/imu/data", imu(header, unit, known, rate, known, force, known)
    yield "/front/imu", imu(header, unit, none, zero, none, force, known)
    field = vector(x=2e-5, y=-1e-6 * k, z=4e-5)
    yield "/imu/mag", t["sensor_msgs/msg/MagneticField"](header, field, known)
    yield "/imu/temperature", t["sensor_msgs/msg/Temperature"](header, 20.0 + 0.5 * k, 0.0)


def log_ns(k):
    return START_NS + 10_000_000 * k + 1_234_567


def write_bag(name, compression):
    store = get_typestore(Stores.ROS1_NOETIC)
    path = HERE / name
    path.unlink(missing_ok=True)
    writer = BagWriter(path)
    writer.set_compression(compression)
    connections = {}
    with writer:
        writer.chunk_threshold = 16384
        for k in range(COUNT):
            for topic, message in messages(store, k):
                kind = message.__msgtype__
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=store)
                writer.write(connections[topic], log_ns(k), store.serialize_ros1(message, kind))


def write_mcap(name, compression, first, last, idl):
    store = get_typestore(Stores.ROS2_HUMBLE)
    with open(HERE / name, "wb") as file:
        writer = McapWriter(file, compression=compression, chunk_size=8192)
        writer.start(profile="ros2", library="make.py")
        channels = {}
        for k in range(first, last):
            for topic, message in messages(store, k):
                kind = message.__msgtype__
                if topic not in channels:
                    text = store.generate_msgdef(kind, ros_version=2)[0]
                    encoding = "ros2msg"
                    if idl and kind in IDL:
                        text, encoding = IDL[kind], "ros2idl"
                    schema = writer.register_schema(kind, encoding, text.encode())
                    channels[topic] = writer.register_channel(topic, "cdr", schema)
                data = store.serialize_cdr(message, kind)
                writer.add_message(channels[topic], log_ns(k), data, log_ns(k), k)
        writer.finish()


write_bag("lz4.bag", BagWriter.CompressionFormat.LZ4)
write_bag("bz2.bag", BagWriter.CompressionFormat.BZ2)
write_mcap("lz4_0.mcap", CompressionType.LZ4, 0, COUNT // 2, False)
write_mcap("zstd_1.mcap", CompressionType.ZSTD, COUNT // 2, COUNT, True)
