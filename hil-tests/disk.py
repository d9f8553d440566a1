#!/usr/bin/env python3
"""Runs on disks that fill up, refuse, stall and lose what was not forced to them; reads what is left.

Usage: disk.py BINARY [full|read-only|slow|power ...]      all four without a name; exit code 1 when one is wrong.

full       a tmpfs fills while a real-time run goes on: the run stops, says why, and loses nothing
read-only  a run is refused before anything moves; a disk that turns read-only stops it
slow       a file system is frozen (fsfreeze) while a real-time run goes on: 5 s cost nothing; in 16 s
           the supervisor stops the table before the ring is full, and what the ring cannot hold is counted;
           the control thread keeps its time in both
power      copies of a running run, cut short or with zeros in their last blocks, are recovered; every row
           that comes back is one that was written

The first three mount file systems of their own and need root; without it they are named and count as failed.
"""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import readback  # noqa: E402

RING_S = 8.0
BLOCK = 4096


def wait_for(condition, what: str, limit_s: float = 60.0):
    end = time.monotonic() + limit_s
    while not (value := condition()):
        if time.monotonic() > end:
            raise AssertionError(f"waited {limit_s} s for {what}")
        time.sleep(0.01)
    return value


class Run:
    """A real-time run in the background."""

    def __init__(self, binary: str, out: Path, steps: str):
        # Standard output goes elsewhere: the disk under test may be full.
        self.said = tempfile.TemporaryFile()
        self.told = tempfile.TemporaryFile()
        # Gentle, so that the skipped periods of a busy machine do not end the run instead of the disk.
        command = [binary, "run", "--real-time", "--ag", "0.005", "--steps", steps, "--out", str(out), "--json"]
        self.process = subprocess.Popen(command, stdout=self.said, stderr=self.told)
        self.folder = wait_for(lambda: self.process.poll() is not None or next(
            (path for path in out.glob("*") if (path / "run.toml").exists()), None), "a run folder")

    def rows(self) -> int:
        try:
            with h5py.File(self.folder / "samples.h5", "r") as file:
                return len(file["samples"])
        except OSError:
            return 0

    def end(self) -> tuple[int, dict, str]:
        code = self.process.wait(timeout=120)
        for file in (self.said, self.told):
            file.seek(0)
        said = self.said.read().decode()
        return code, json.loads(said) if said.strip() else {}, self.told.read().decode()


@contextmanager
def mounted(kind: str, megabytes: int):
    """A tmpfs, or an ext4 in a file."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "disk"
        place.mkdir()
        if kind == "tmpfs":
            mount = ["mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "none", place]
        else:
            image = Path(folder) / "image"
            with open(image, "wb") as file:
                file.truncate(megabytes << 20)
            subprocess.run(["mkfs.ext4", "-q", image], check=True)
            mount = ["mount", "-o", "loop", image, place]
        subprocess.run(mount, check=True)
        try:
            yield place
        finally:
            subprocess.run(["umount", "-l", place], check=True)


def verified(binary: str, run: Path) -> None:
    outcome = subprocess.run([binary, "runs", "verify", run, "--json"], capture_output=True, text=True)
    assert outcome.returncode == 0, f"runs verify: {outcome.stdout}{outcome.stderr}"


def full(binary: str) -> str:
    with mounted("tmpfs", 64) as disk:
        run = Run(binary, disk / "runs", "2.0..2.5")
        wait_for(lambda: run.rows() > 3 * 2048, "three seconds of samples")
        other = os.open(disk / "other", os.O_WRONLY | os.O_CREAT)
        try:
            while True:
                os.write(other, bytes(BLOCK))
        except OSError:
            os.close(other)
        code, report, told = run.end()
        assert code == 1 and "space" in told, f"exit code {code}: {told}"
        result = readback.check(run.folder)
        assert not result["problems"], result["problems"]
        assert result["state"] == "failed", result["state"]
        manifest = readback.tomllib.loads((run.folder / "run.toml").read_text())
        assert manifest["lost"]["samples"] == 0, manifest["lost"]
        verified(binary, run.folder)
        # The table was brought to rest and that is on record too.
        with h5py.File(run.folder / "samples.h5") as file:
            tail = file["samples"][-256:]
        assert not tail["command_velocity_m_s"].any(), "the record ends before the table rests"
        return f"stopped, {result['rows']} rows, 0 lost, closed and verified"


def read_only(binary: str) -> str:
    with mounted("ext4", 96) as disk:
        subprocess.run(["mount", "-o", "remount,ro", disk], check=True)
        outcome = subprocess.run([binary, "run", "--steps", "2.0..2.5", "--out", disk / "runs"], capture_output=True)
        assert outcome.returncode == 1 and b"ead-only" in outcome.stderr, outcome.stderr.decode()
        subprocess.run(["mount", "-o", "remount,rw", disk], check=True)
    # A disk that turns read-only by itself does so on an error; `emergency remount` is the nearest to that.
    return "refused before the start: " + outcome.stderr.decode().strip().splitlines()[-1][-60:]


def frozen(binary: str, seconds: float) -> tuple[int, dict, dict, dict]:
    with mounted("ext4", 192) as disk:
        run = Run(binary, disk / "runs", "1.5..1.6")
        wait_for(lambda: run.rows() > 2 * 2048, "two seconds of samples")
        subprocess.run(["fsfreeze", "-f", disk], check=True)
        try:
            time.sleep(seconds)
        finally:
            subprocess.run(["fsfreeze", "-u", disk], check=True)
        code, report, told = run.end()
        assert code in (0, 3), f"exit code {code}, {report.get('outcome')}, {report.get('cause')}: {told}"
        result = readback.check(run.folder)
        assert not result["problems"], result["problems"]
        verified(binary, run.folder)
        return code, report, result, readback.tomllib.loads((run.folder / "run.toml").read_text())


def slow(binary: str) -> str:
    lines = []
    for seconds in (5.0, 16.0):
        code, report, result, manifest = frozen(binary, seconds)
        lost = manifest["lost"]["ring"] / 2048
        rows = result["rows"] + manifest["lost"]["samples"]
        duration = rows / 2048
        assert manifest["lost"]["daq"] == 0 and manifest["lost"]["disk"] == 0, manifest["lost"]
        if seconds < RING_S:
            assert code == 0, f"a stall of {seconds} s ended the run: {report.get('cause')}"
            assert lost == 0, f"{lost} s lost"
        else:
            # The supervisor brings the table to rest before the ring is full; what does not fit is counted.
            assert code == 3 and "recorder-behind" in str(report["cause"]), f"exit code {code}: {report['cause']}"
            assert lost <= seconds - RING_S + 0.5, f"{lost} s lost of a stall of {seconds} s"
            assert manifest["clean"] == (lost == 0), "a run with losses calls itself clean"
        worst = report["timing"]["step"]["max_us"]
        assert worst < 1e6 * seconds / 10, f"a control step took {worst} us"
        lines.append(f"{seconds:g} s frozen: {report['outcome']}, {lost:.2f} s lost, {report['slips']} slips, "
                     f"step p99.9 {report['timing']['step']['p999_us']:.0f} us of {duration:.0f} s")
    return "; ".join(lines)


def hurt(samples: Path, moments: random.Random) -> int:
    """Cuts the file or zeroes its last blocks; returns how many bytes are lost."""
    size = samples.stat().st_size
    if moments.random() < 0.5:
        cut = moments.randrange(0, min(size, 1 << 20))
        os.truncate(samples, size - cut)
        return cut
    blocks = moments.randrange(1, 64)
    start = max(0, (size // BLOCK - blocks) * BLOCK)
    with open(samples, "r+b") as file:
        file.seek(start)
        file.write(bytes(size - start))
    return size - start


def power(binary: str, copies: int = 40) -> str:
    moments = random.Random(11)
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        run = Run(binary, folder / "runs", "2.0..2.9")
        cut, taken = [], 0
        while run.process.poll() is None and taken < copies:
            time.sleep(moments.uniform(0.1, 0.5))
            copy = folder / f"copy-{taken}"
            shutil.copytree(run.folder, copy)
            at_least = run.rows()
            cut.append((copy, at_least))
            taken += 1
        if run.process.poll() is None:
            run.process.send_signal(signal.SIGINT)
        run.process.wait(timeout=120)
        with h5py.File(run.folder / "samples.h5") as file:
            truth = file["samples"][:]
        worst_s, recovered_rows = 0.0, 0
        for copy, rows_then in cut:
            lost_bytes = hurt(copy / "samples.h5", moments)
            outcome = subprocess.run([binary, "recover", copy, "--json"], capture_output=True, text=True)
            assert outcome.returncode == 0, f"{copy.name}: {outcome.stderr}"
            result = readback.check(copy)
            # A hole in the middle leaves a jump that no event tells.
            problems = [p for p in result["problems"] if "has no record" not in p and "lost, found" not in p]
            assert not problems, f"{copy.name}: {problems}"
            with h5py.File(copy / "samples.h5") as file:
                found = file["samples"][:]
            # By number: a machine that had no time for the control thread leaves jumps.
            places = np.searchsorted(truth["sequence"], found["sequence"]).clip(max=len(truth) - 1)
            other = np.flatnonzero(truth[places] != found)
            assert not len(other), f"{copy.name}: {len(other)} rows differ from what was written, the first {found[other[0]]}"
            # What was cut or zeroed, and what stands between the chunks, is all that may be missing.
            missing = rows_then - len(found)
            allowed = lost_bytes / 112 + 0.5 * 2048
            assert missing <= allowed, f"{copy.name}: {missing} rows missing, {lost_bytes} bytes hurt"
            worst_s = max(worst_s, (missing - lost_bytes / 112) / 2048)
            recovered_rows += len(found)
        return f"{len(cut)} hurt copies recovered, {recovered_rows} rows, all as written; at most {worst_s:.3f} s missing beyond the hurt blocks"


TESTS = {"full": full, "read-only": read_only, "slow": slow, "power": power}


def main() -> int:
    if len(sys.argv) < 2:
        print(__doc__)
        return 2
    binary = os.path.abspath(sys.argv[1])
    failed = False
    for name in sys.argv[2:] or TESTS:
        try:
            if name != "power" and os.geteuid() != 0:
                raise AssertionError("needs root to mount a file system")
            print(f"{name}: {TESTS[name](binary)}", flush=True)
        except (AssertionError, OSError, subprocess.SubprocessError) as error:
            failed = True
            print(f"{name}: FAILED {error}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
