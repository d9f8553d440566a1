#!/usr/bin/env python3
"""Reads run folders back with h5py, an independent implementation, and checks them.

Usage: readback.py RUN [RUN ...]        prints a line a run; exit code 1 when one is wrong.

Checked: the columns, time against number, that numbers rise and every jump is a gap record of
events.jsonl, the hash chain over the rows and the hash of the events, and the counts in run.toml. A run whose process
was killed (its run.toml still says running) is checked as far as its samples go.
"""

import hashlib
import json
import sys
import tomllib
from pathlib import Path

import h5py
import numpy as np

COLUMNS = [
    "time_s", "sequence", "device_time_us", "table_displacement_m", "table_acceleration_m_s2",
    "mass_acceleration_1_m_s2", "mass_acceleration_2_m_s2", "relative_displacement_m",
    "command_displacement_m", "command_velocity_m_s", "command_acceleration_m_s2",
    "model_displacement_m", "model_acceleration_m_s2", "step", "status", "flags", "lost_before",
]
LINK_ROWS = 2048
MOST_APPENDED = 16 * 512 + LINK_ROWS


def check(run: Path) -> dict:
    manifest = tomllib.loads((run / "run.toml").read_text())
    finished = manifest["state"] != "running"
    with h5py.File(run / "samples.h5", "r") as file:
        data = file["samples"]
        rate = float(data.attrs["sample_rate_hz"])
        rows = data[:]
    problems = []

    def expect(condition, text):
        if not condition:
            problems.append(text)

    expect(list(rows.dtype.names) == COLUMNS, f"columns {rows.dtype.names}")
    expect(rate == manifest["sample_rate_hz"], f"rate {rate} Hz")
    expect(np.array_equal(rows["time_s"], rows["sequence"] / rate), "time_s is not sequence / rate")
    jumps = np.diff(rows["sequence"].astype(np.int64))
    expect((jumps >= 1).all(), "numbers do not rise")
    events = [json.loads(line) for line in (run / "events.jsonl").read_text().splitlines() if line.endswith("}")]
    gaps = {e["after"]: e["missing"] for e in events if e["event"] == "gap" and e["before"] is not None}
    for at in np.flatnonzero(jumps != 1):
        after = int(rows["sequence"][at])
        expect(gaps.get(after) == int(jumps[at]) - 1, f"gap after {after} has no record")
    links = {}
    for line in (run / "integrity.txt").read_text().splitlines():
        words = line.split()
        if len(words) == 3 and len(words[2]) == 64:
            links[int(words[0])] = words[1:]
    chain = bytes(32)
    for start in range(0, len(rows), LINK_ROWS):
        block = hashlib.sha256(rows[start:start + LINK_ROWS].tobytes())
        chain = hashlib.sha256(chain + block.digest()).digest()
        end = min(start + LINK_ROWS, len(rows))
        if end in links:
            expect(links[end] == [block.hexdigest(), chain.hex()], f"hash chain breaks before row {end}")
        else:
            # The links of the rows appended last may be under way when the process dies.
            expect(not finished and end > len(rows) - MOST_APPENDED, f"no link of the hash chain at row {end}")
    if len(rows) == 0:
        chain = hashlib.sha256(chain + hashlib.sha256(b"").digest()).digest()
    expect(max(links, default=0) <= len(rows), "the hash chain goes on behind the last row")
    if finished:
        expect(manifest["samples"] == len(rows), f"run.toml says {manifest['samples']} samples")
        expect(manifest.get("samples_sha256") == chain.hex(), "the hash of all rows differs")
        events_bytes = (run / "events.jsonl").read_bytes()[:manifest["events_bytes"]]
        expect(manifest["events_sha256"] == hashlib.sha256(events_bytes).hexdigest(), "the events differ")
        # Losses after the last row leave no jump; the gap record without an end tells them.
        tail = sum(e["missing"] for e in events if e["event"] == "gap" and e["before"] is None)
        head = sum(e["missing"] for e in events if e["event"] == "gap" and e["after"] is None and e["before"] is not None)
        lost = int((jumps - 1).sum()) + tail + head
        expect(manifest["lost"]["samples"] == lost, f"run.toml says {manifest['lost']['samples']} lost, found {lost}")
    expect(rows["step"].min(initial=-1) >= -1, "step below -1")
    return {"run": str(run), "state": manifest["state"], "rows": len(rows), "seconds": len(rows) / rate, "problems": problems}


def main() -> int:
    results = [check(Path(run)) for run in sys.argv[1:]]
    for result in results:
        print(json.dumps(result))
    if not results:
        print(__doc__)
        return 2
    return 1 if any(result["problems"] for result in results) else 0


if __name__ == "__main__":
    sys.exit(main())
