#!/usr/bin/env python3
"""A whole lab on a virtual CAN interface and a pseudo terminal: `shaketable emulate` on one side, the product on the other.

Usage: lab.py BINARY [LOW..HIGH] [KILLS]     inside the guest: hil-tests/uml/run -- python3 hil-tests/uml/lab.py ...

A daemon that is killed (SIGKILL) in motion leaves the drive in quick stop within 50 ms, by the drive's own time-outs, each
time; the sweep goes through at the first attempt, loses no sample and shows the peaks of the simulated rig. The guest's clock
does not count what the machine does meanwhile (clock.c), so that nothing here is excused by a busy one.
"""

import json
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

RIG = Path(__file__).parents[2] / "config/rigs/lab.toml"
# Noise of 0.01 m/s2 on peaks from 0.2 m/s2 up, of 30 um on excursions from 6 mm up.
A_MAX, E_MAX = 0.06, 0.02
QUICK_STOP_S = 0.050
# From the start of the emulator to its report; the kill comes some ten seconds after the start.
EMULATED_S = 45


def emulator(binary: str, duration_s: float, *faults: str) -> subprocess.Popen:
    command = [binary, "emulate", "--rig", str(RIG), "--duration", str(duration_s), "--json"]
    for fault in faults:
        command += ["--fault", fault]
    lab = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    line = lab.stderr.readline()
    assert line.startswith("emulating"), line
    return lab


def run(binary: str, rig: Path, out: Path, steps: str) -> dict:
    command = [binary, "run", "--rig", str(rig), "--steps", steps, "--out", str(out), "--json"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.stdout.strip(), done.stderr
    result = json.loads(done.stdout)
    links = [line for line in done.stderr.splitlines() if line.startswith("DAQ line")]
    print(f"{rig.stem}, {steps} Hz: {result['outcome']}, cause {result['cause']}, {result['samples']} samples, "
          f"{result['lost_samples']} lost, {result['slips']} slips", *links, sep="\n  ", flush=True)
    assert result["outcome"] == "done" and result["lost_samples"] == 0, done.stderr
    return result


def sweep(binary: str, out: Path, steps: str) -> None:
    simulated_rig = out / "simulated.toml"
    simulated_rig.write_text(RIG.read_text().split("[hardware")[0])
    simulated = run(binary, simulated_rig, out, steps)["steps"]
    lab = emulator(binary, 3600)
    try:
        emulated = run(binary, RIG, out, steps)["steps"]
    finally:
        lab.kill()
    assert len(emulated) == len(simulated), "steps are missing"
    deviation = lambda key: max(abs(a[key] / b[key] - 1) for a, b in zip(emulated, simulated))
    a_max, e_max = deviation("a_max_m_s2"), deviation("excursion_m")
    print(f"{len(simulated)} steps against the simulated rig: A_max within {a_max:.4f}, E_max within {e_max:.4f}")
    assert a_max < A_MAX and e_max < E_MAX


def wait_for_step(url: str) -> None:
    """Waits until the sweep has moved the table for a while: the first step has begun."""
    while True:
        with urllib.request.urlopen(f"{url}/api/v1/status") as answer:
            status = json.load(answer)
        assert status["state"] == "running", status
        if status["run"]["step"] is not None:
            return
        time.sleep(0.05)


def kill(binary: str, out: Path) -> float:
    """Time from the last SYNC of a daemon that was killed in motion to quick stop, s."""
    lab = emulator(binary, EMULATED_S)
    daemon = subprocess.Popen([binary, "serve", "--listen", "127.0.0.1:0", "--rig", str(RIG), "--out", str(out)],
                              stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        url = daemon.stdout.readline().strip()
        command = [binary, "start", "--confirm", "--url", url, "--json"]
        started = subprocess.run(command, capture_output=True, text=True)
        assert started.returncode == 0, f"start ends with {started.returncode}: {started.stderr}"
        wait_for_step(url)
        daemon.send_signal(signal.SIGKILL)
        daemon.wait()
        report = json.loads(lab.communicate()[0])
    finally:
        daemon.kill()
        lab.kill()
    print(f"killed in motion: {report}", flush=True)
    assert report["drive"] == "QuickStopActive" and report["velocity_m_s"] == 0, report
    # It was not at rest in the middle, where every run begins.
    assert abs(report["displacement_m"]) > 1e-4, report
    return report["stopped_itself_after_s"]


def main() -> int:
    binary, steps, kills = (sys.argv[1:] + ["1.0..2.0", "3"][len(sys.argv) - 2 :])[:3]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        times = [kill(binary, out) for _ in range(int(kills))]
        print(f"from the last SYNC of a killed daemon to quick stop: {[round(1e3 * t, 1) for t in times]} ms")
        assert all(t < QUICK_STOP_S for t in times)
        sweep(binary, out, steps)
    return 0


if __name__ == "__main__":
    sys.exit(main())
