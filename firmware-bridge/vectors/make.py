#!/usr/bin/env python3
"""Writes daq-frames.json: test vectors of the DAQ line, made without any code of the product.

COBS, CRC-32 (zlib's) and the layouts are written out here from docs/wire-formats.md, so that
a mistake in the Rust code and the same mistake in the vectors is unlikely. Run it again after the
page changes; the test `vectors` compares both directions.
"""
import json
import pathlib
import struct
import zlib


def cobs(content: bytes) -> bytes:
    out = bytearray()
    for block in content.split(b"\0"):
        assert len(block) < 254
        out += bytes([len(block) + 1]) + block
    return bytes(out)


def wire(content: bytes) -> str:
    return (cobs(content + struct.pack("<I", zlib.crc32(content))) + b"\0").hex()


def text(value: str) -> bytes:
    return value.encode("ascii").ljust(16, b"\0")


def i24(value: int) -> bytes:
    return struct.pack("<i", value)[:3]


def sample(status, sequence, time_us, counts):
    content = struct.pack("<BHIQ", 0xA0, status, sequence, time_us) + b"".join(i24(c) for c in counts)
    return {"kind": "sample", "status": status, "sequence": sequence, "device_time_us": time_us,
            "counts": counts, "wire": wire(content)}


def calibration(channel, unit, scale, offset, full_scale, date, sensor):
    content = struct.pack("<BBBdddI", 0x85, channel, unit, scale, offset, full_scale, date) + text(sensor)
    return {"kind": "calibration", "channel": channel, "unit": unit, "scale": scale, "offset": offset,
            "full_scale": full_scale, "date": date, "sensor": sensor, "wire": wire(content)}


def identity(protocol, vendor, product, firmware, serial, channels):
    content = struct.pack("<BHIII", 0x81, protocol, vendor, product, firmware) + text(serial) + bytes([channels])
    return {"kind": "identity", "protocol": protocol, "vendor": vendor, "product": product,
            "firmware": firmware, "serial": serial, "channels": channels, "wire": wire(content)}


VECTORS = [
    {"kind": "identify", "wire": wire(b"\x01")},
    {"kind": "configure", "rate_mhz": 2048000, "bandwidth_mhz": 0, "wire": wire(struct.pack("<BII", 2, 2048000, 0))},
    {"kind": "start", "token": 0xDEADBEEF, "wire": wire(struct.pack("<BI", 3, 0xDEADBEEF))},
    {"kind": "stop", "wire": wire(b"\x04")},
    {"kind": "read-calibration", "channel": 4, "wire": wire(b"\x05\x04")},
    identity(1, 0x53484B54, 0x00010005, 0x01020003, "KR-0001", 5),
    {"kind": "acknowledge", "request": 2, "code": 0, "value": 2048000, "wire": wire(struct.pack("<BBBI", 0x82, 2, 0, 2048000))},
    {"kind": "acknowledge", "request": 3, "code": 2, "value": 0, "wire": wire(struct.pack("<BBBI", 0x82, 3, 2, 0))},
    {"kind": "acknowledge", "request": 0x7F, "code": 3, "value": 0, "wire": wire(struct.pack("<BBBI", 0x82, 0x7F, 3, 0))},
    calibration(0, 1, 1.25e-8, 0.0, 0.1, 20260301, "LVDT-17"),
    calibration(1, 2, 2.3384e-6, -0.0125, 19.6133, 20260301, "ACC-4401"),
    calibration(4, 1, -5.9604644775390625e-09, 0.003, 0.05, 0, "LASER-123456789A"),
    sample(0, 0, 0, [0, 0, 0, 0, 0]),
    sample(0, 1, 488, [1, -1, 256, -256, 65536]),
    sample(31, 0xFFFFFFFF, 0xFFFFFFFFFFFFFFFF, [8388607, -8388608, -1, -1, -1]),
    sample(0x0101, 0x01000001, 0x0000000100000001, [-8388608, 8388607, 0, 1, -2]),
    sample(0, 2048, 1000000, [123456, -654321, 1000000, -1000000, 42]),
]

if __name__ == "__main__":
    path = pathlib.Path(__file__).with_name("daq-frames.json")
    lines = ",\n".join("  " + json.dumps(vector) for vector in VECTORS)
    path.write_text(f"[\n{lines}\n]\n")
