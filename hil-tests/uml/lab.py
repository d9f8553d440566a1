#!/usr/bin/env python3
"""A whole lab on a virtual CAN interface and a pseudo terminal: `shaketable emulate` on one side, the product on the other.

Usage: lab.py BINARY [LOW..HIGH] [KILLS]     inside the guest: hil-tests/uml/run -- python3 hil-tests/uml/lab.py ...

A daemon that is killed (SIGKILL) in motion, in its second run, leaves the drive in quick stop within 50 ms, by the drive's own
time-outs, each time; the sweep goes through at the first attempt, loses no sample and shows the peaks of the simulated rig. The guest's clock
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
# Lines of an error output that a failed assertion quotes: it may be cut at its end.
QUOTED_LINES = 3


def emulator(binary: str, *faults: str) -> subprocess.Popen:
    command = [binary, "emulate", "--rig", str(RIG), "--json"]
    for fault in faults:
        command += ["--fault", fault]
    lab = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    line = lab.stderr.readline()
    assert line.startswith("emulating"), line
    return lab


def report_at_rest(lab: subprocess.Popen) -> dict:
    """What the emulator tells of the drive, once that has come to rest."""
    told, complaints = lab.communicate("end\n")
    assert told.strip(), f"the emulator ends with {lab.returncode}: {last_lines(complaints)}"
    return json.loads(told)


def last_lines(text: str) -> str:
    return "\n".join(text.strip().splitlines()[-QUOTED_LINES:])


def run(binary: str, rig: Path, out: Path, steps: str) -> dict:
    command = [binary, "run", "--rig", str(rig), "--steps", steps, "--out", str(out), "--json"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.stdout.strip(), f"run ends with {done.returncode}: {last_lines(done.stderr)}"
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
    lab = emulator(binary)
    try:
        emulated = run(binary, RIG, out, steps)["steps"]
    finally:
        lab.kill()
    assert len(emulated) == len(simulated), "steps are missing"
    deviation = lambda key: max(abs(a[key] / b[key] - 1) for a, b in zip(emulated, simulated))
    a_max, e_max = deviation("a_max_m_s2"), deviation("excursion_m")
    print(f"{len(simulated)} steps against the simulated rig: A_max within {a_max:.4f}, E_max within {e_max:.4f}")
    assert a_max < A_MAX and e_max < E_MAX


def wait_until(url: str, states: set, reached) -> None:
    """Waits until the status of a daemon is as wanted; it may go through these states only."""
    while True:
        with urllib.request.urlopen(f"{url}/api/v1/status") as answer:
            status = json.load(answer)
        assert status["state"] in states, status
        if reached(status):
            return
        time.sleep(0.05)


def start(binary: str, url: str, log: Path) -> None:
    """Starts a run of a daemon and waits until the sweep has moved the table for a while: the first step has begun."""
    started = subprocess.run([binary, "start", "--confirm", "--url", url, "--json"], capture_output=True, text=True)
    assert started.returncode == 0, (
        f"start ends with {started.returncode}: {last_lines(started.stderr)}\nthe daemon: {last_lines(log.read_text())}"
    )
    wait_until(url, {"running"}, lambda status: status["run"]["step"] is not None)


def kill(binary: str, out: Path) -> float:
    """Time from the last SYNC of a daemon that was killed in motion to quick stop, s. It has stopped a run before, so that
    the links have been opened anew for checks, run, checks and run."""
    lab = emulator(binary)
    log = out / "daemon.log"
    with log.open("w") as errors:
        daemon = subprocess.Popen([binary, "serve", "--listen", "127.0.0.1:0", "--rig", str(RIG), "--out", str(out)],
                                  stdout=subprocess.PIPE, stderr=errors, text=True)
    try:
        url = daemon.stdout.readline().strip()
        start(binary, url, log)
        subprocess.run([binary, "stop", "--url", url], check=True, stdout=subprocess.DEVNULL)
        wait_until(url, {"running", "stopping", "stopped"}, lambda status: status["state"] == "stopped")
        start(binary, url, log)
        daemon.send_signal(signal.SIGKILL)
        daemon.wait()
        report = report_at_rest(lab)
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
