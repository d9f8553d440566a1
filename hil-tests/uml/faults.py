#!/usr/bin/env python3
"""Every fault of the links in the middle of a run: each ends in the state and within the time that docs/hardware.md states, no
sample that reached the host is missing from the record, and the operator is told which cable.

Usage: faults.py BINARY [NAME...]     inside the guest: hil-tests/uml/run -- python3 hil-tests/uml/faults.py ...
"""

import json
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from lab import RIG, emulator, report_at_rest

RATE_HZ = 2048
# Seconds after the drive was enabled: the check before the run takes five, the sweep's ramp one.
FAULT_AT_S = 8


@dataclass
class Expected:
    """What must come of a fault; times in s, `None` for what is not asked."""

    outcome: str
    told: str
    # From the fault to the first word of it in the run's events.
    noticed_s: float | None = None
    # From the fault until the drive is out of operation, and its states then.
    out_s: float | None = None
    states: tuple = ()
    lost: range = range(0, 1)


STOPPED = ("QuickStopActive",)
TRIPPED = ("Fault", "FaultReactionActive")
# A run that was broken off leaves the drive without power once the table rests, unless no word reaches it any more.
OFF = ("SwitchOnDisabled", "QuickStopActive")
FAULTS = {
    "daq unplug": Expected("aborted", "DAQ cable", 0.005, 1.6, OFF),
    "daq silent": Expected("aborted", "DAQ cable", 0.060, 1.6, OFF),
    "daq garbage 500": Expected("done", "DAQ cable", lost=range(0, 3)),
    "daq bit-errors 1e-4": Expected("done", "DAQ cable", lost=range(100, 1000)),
    "daq hold 33": Expected("done", "", lost=range(0, 1)),
    "drive silent": Expected("aborted", "drive cable", 0.065, 0.050, STOPPED),
    "drive bus-off": Expected("aborted", "drive cable", 0.005, 0.050, OFF),
    "drive trip 0x2320": Expected("aborted", "short circuit", 0.005, 0.005, TRIPPED + OFF),
    "drive restart": Expected("aborted", "check its power", 0.065, 0.005, ("SwitchOnDisabled",)),
}


def run(binary: str, rig: Path, out: Path) -> subprocess.CompletedProcess:
    command = [binary, "run", "--rig", str(rig), "--steps", "2.0..2.0", "--out", str(out), "--json"]
    return subprocess.run(command, capture_output=True, text=True)


def noticed_s(folder: Path, received: int, report: dict) -> float:
    """From the fault to the abort. While samples come their numbers are the clock, without them the control periods."""
    events = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    abort = next(event for event in events if event["event"] == "abort")
    if abort["sequence"] + 1 < received:
        return (abort["sequence"] - report["fault_at_sequence"]) / RATE_HZ
    # `stale-sample` counts the periods since the last sample came, which went out as the fault began.
    stale = next(event for event in events if event["event"] == "finding" and event["detector"] == "stale-sample")
    return (abort["cycle"] - (stale["cycle"] - stale["value"])) / RATE_HZ


def check(binary: str, out: Path, fault: str, expected: Expected) -> None:
    lab = emulator(binary, f"{FAULT_AT_S} {fault}")
    try:
        done = run(binary, RIG, out)
        report = report_at_rest(lab)
    finally:
        lab.kill()
    assert done.stdout.strip(), done.stderr
    result = json.loads(done.stdout)
    told = [line for line in done.stderr.splitlines() if ": check" in line or "tripped" in line]
    received, late = map(int, re.search(r"DAQ line: (\d+) samples.* (\d+) late", done.stderr).groups())
    folder = Path(result["run_dir"])
    noticed = noticed_s(folder, received, report) if expected.outcome == "aborted" else None
    out_s = report["out_of_operation_after_fault_s"]
    print(f"{fault}: {result['outcome']} ({result['cause']}), {result['lost_samples']} lost, {late} late; told: {told}", end="")
    if noticed is not None:
        print(f"; noticed after {1e3 * noticed:.1f} ms, drive out of operation after {1e3 * out_s:.1f} ms: {report['drive']}", end="")
    print(flush=True)
    assert result["outcome"] == expected.outcome, done.stderr
    assert expected.told in " ".join(told), done.stderr
    assert result["lost_samples"] in expected.lost, result["lost_samples"]
    if fault.startswith("daq hold"):
        assert late > 0
    if expected.outcome == "done":
        # The table's motion knows nothing of what happened on the line.
        assert len(result["steps"]) == 2, result["steps"]
        assert result["clean"] == (result["lost_samples"] == 0)
        return
    assert 0 <= noticed <= expected.noticed_s, noticed
    assert out_s <= expected.out_s, out_s
    assert report["drive"] in expected.states and report["velocity_m_s"] == 0, report
    if fault.startswith("daq"):
        # The last sample that came is the last that the run saw: all of them are in the record, without a gap.
        events = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
        assert next(e for e in events if e["event"] == "abort")["sequence"] == received - 1
        assert received >= report["fault_at_sequence"], (received, report)


def pull_interface(binary: str, out: Path) -> None:
    """The CAN interface itself goes down in motion."""
    lab = emulator(binary)
    pull = subprocess.Popen(["sh", "-c", f"sleep {FAULT_AT_S + 1}; ip link set vcan0 down"])
    try:
        done = run(binary, RIG, out)
        report = report_at_rest(lab)
    finally:
        lab.kill()
        pull.wait()
        subprocess.run(["ip", "link", "set", "vcan0", "up"], check=True)
    result = json.loads(done.stdout)
    after_s = report["stopped_itself_after_s"]
    print(f"interface down: {result['outcome']} ({result['cause']}), {result['lost_samples']} lost; drive {report['drive']} "
          f"{1e3 * after_s:.1f} ms after the last SYNC", flush=True)
    assert result["outcome"] == "aborted" and result["lost_samples"] == 0, done.stderr
    assert "drive cable" in done.stderr, done.stderr
    assert report["drive"] == "QuickStopActive" and after_s < 0.050, report


def wrong_devices(binary: str, out: Path) -> None:
    """Other devices than the rig file's are refused before anything moves."""
    text = RIG.read_text()
    changes = {
        "DAQ": ("product = 0x0001", "product = 0x0002", "0x00000001"),
        "drive": ("product = 0x0402", "product = 0x0403", "0x00000402"),
    }
    for device, (before, after, answered) in changes.items():
        assert text.count(before) == 1
        rig = out / f"wrong-{device}.toml"
        rig.write_text(text.replace(before, after))
        lab = emulator(binary)
        try:
            done = run(binary, rig, out)
            report = report_at_rest(lab)
        finally:
            lab.kill()
        words = " ".join(line.strip(" \u2502\u00d7") for line in done.stderr.splitlines())
        print(f"wrong {device}: exit {done.returncode}, {words}", flush=True)
        assert done.returncode == 1 and f"wrong {device}" in words and answered in words, done.stderr
        assert report["drive"] == "SwitchOnDisabled" and report["out_of_operation_after_fault_s"] is None, report
        # Noise of the table's own sensor, by which a drive without power knows where it is.
        assert abs(report["displacement_m"]) < 1e-4, report


def main() -> int:
    binary, names = sys.argv[1], sys.argv[2:]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        for fault, expected in FAULTS.items():
            if not names or fault in names:
                check(binary, out, fault, expected)
        for test in (pull_interface, wrong_devices):
            if not names or test.__name__ in names:
                test(binary, out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
