"""Prints the messages of each topic of an MCAP file as JSON, flat, as two readers decode them."""

import json
import sys
from pathlib import Path

import numpy as np
from mcap_ros2.reader import read_ros2_messages
from rosbags.highlevel import AnyReader


def flat(value):
    if isinstance(value, (str, int, float)):
        return [value]
    if isinstance(value, (list, tuple, bytes, bytearray, memoryview, np.ndarray)):
        items = list(value.tolist() if isinstance(value, np.ndarray) else value)
    else:
        names = getattr(value, "__slots__", None) or list(vars(value))
        items = [getattr(value, name) for name in names if not name.startswith("_")]
    return [number for item in items for number in flat(item)]


first, second = {}, {}
with AnyReader([Path(sys.argv[1])]) as reader:
    for connection, _, data in reader.messages():
        message = reader.deserialize(data, connection.msgtype)
        first.setdefault(connection.topic, []).append(flat(message))
for read in read_ros2_messages(sys.argv[1]):
    second.setdefault(read.channel.topic, []).append(flat(read.ros_msg))
print(json.dumps([first, second]))
