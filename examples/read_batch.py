"""Frames and batches of the wire protocol, decoded: python3 examples/read_batch.py tests/vectors/v3/batch.hex

Each frame of the file follows a line with its meaning; `ok` says that it was decoded to that. docs/reference/protocol.md, section 9."""

import sys

def crc32c(data):
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF

def frame(coded):
    """Kind, version and body of the bytes between two zeros; None if they are damaged."""
    plain, at = bytearray(), 0
    while at < len(coded):
        code = coded[at]
        if at + code > len(coded):
            return None
        plain += coded[at + 1 : at + code]
        at += code
        if code < 255 and at < len(coded):
            plain.append(0)
    if len(plain) < 5 or crc32c(plain[:-4]) != int.from_bytes(plain[-4:], "little"):
        return None
    return plain[0] & 15, plain[0] >> 4, bytes(plain[1:-4])

def batch(kind, body):
    """Low bits of sequence number and time, and the samples, of the body of a Batch or Inertial."""
    extension, body = (body[0], body[1:]) if kind == 7 else (0, body)
    sensors, wide = 1 + (extension >> 3 & 1), extension >> 4 & 1
    count, corrected = (body[0] & 31) + 1, body[0] >> 5 & 1
    if extension >> 5 or wide and corrected or count * sensors > 32:
        raise ValueError("not a batch of version 3")
    W, F = (32, 5) if corrected else (20, 5) if wide else (16, 4)
    start = 7 if body[0] & 128 else 6  # body[6] is then the decimation
    left, bits = 8 * (len(body) - start), int.from_bytes(body[start:], "big")

    def pull(n):
        nonlocal left
        left -= n
        if left < 0:
            raise ValueError("the batch ends too early")
        return bits >> left & ((1 << n) - 1)

    def wrap(value, width=W):
        return (value + (1 << width - 1)) % (1 << width) - (1 << width - 1)

    def residual(k):
        ones = 0
        while ones < 12 and pull(1):
            ones += 1
        u = pull(W) if ones == 12 else ones << k | pull(k)
        return u >> 1 if u % 2 == 0 else -(u + 1 >> 1)

    def axis():
        nonlocal k
        coding = pull(2)
        if coding == 0:
            width = pull(F) + 1
            return [wrap(pull(width), width) for _ in range(count)]
        if k is None or (changed := pull(1)) and pull(1):
            k = pull(F)
        elif changed:
            k += -1 if pull(1) else 1
        length, negative = pull(F), pull(1)
        m = 1 << length - 1 | pull(length - 1) if length else 0
        values = [-m - 1 if negative else m]
        mean = wrap((values[0] << 4) + 8, 32)
        for i in range(1, count):
            v, before = values[-1], values[-2] if i > 1 else values[-1]
            predicted = {1: mean >> 4, 3: 2 * v - before}[coding]
            values.append(wrap(predicted + residual(k)))
            missed = values[-1] - (mean >> 4)
            mean = wrap(mean + (missed << 5 >> (i + 1).bit_length()), 32)
        return values

    k = None
    shifts = [pull(F) if body[0] >> 6 & 1 else 0 for _ in range(sensors)]
    axes = [[wrap(v << shift) for v in axis()] for shift in shifts for _ in range(3)]
    if left >= 8 or pull(left):
        raise ValueError("the batch goes on after its samples")
    sequence, time = int.from_bytes(body[1:3], "little"), int.from_bytes(body[3:6], "little")
    return sequence, time, [list(sample) for sample in zip(*axes)]

expected = ""
for line in open(sys.argv[1]):  # tests/vectors/v3/batch.hex, inertial.hex
    if line.startswith("#"):
        expected = line[line.index(": [[") + 2 :].strip()
    else:
        kind, version, body = frame(bytes.fromhex(line)[:-1])
        print("ok" if str(batch(kind, body)[2]) == expected else "WRONG", expected[:60])
