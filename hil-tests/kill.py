#!/usr/bin/env python3
"""Kills real-time runs at random moments (SIGKILL) and reads what is left with h5py.

Usage: kill.py BINARY [COUNT] [SEED]     prints a line a kill and a summary; exit code 1 when one is wrong.

Each time: the file opens at once, readback.py finds nothing wrong, the rows missing against the time
that went by are counted, `recover` closes the folder and `runs` lists it as interrupted.
"""

import json
import random
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timezone
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import readback  # noqa: E402

LONGEST_MISSING_S = 0.5


def kill_once(binary: str, out: Path, moment_s: float) -> dict:
    before = set(out.iterdir()) if out.exists() else set()
    # Gentle, so that the skipped periods of a busy machine do not end the run before the kill does.
    command = [binary, "run", "--real-time", "--ag", "0.005", "--steps", "1.0..1.5", "--out", str(out), "--json"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    run = None
    while run is None:
        if process.poll() is not None:
            raise RuntimeError(f"the run ended by itself with {process.returncode}")
        new = set(out.iterdir()) - before if out.exists() else set()
        run = next((path for path in new if (path / "run.toml").exists()), None)
        time.sleep(0.005)
    time.sleep(moment_s)
    process.send_signal(signal.SIGKILL)
    killed = datetime.now(timezone.utc)
    process.wait()
    manifest = readback.tomllib.loads((run / "run.toml").read_text())
    started = datetime.fromisoformat(manifest["started_utc"].replace("Z", "+00:00"))
    result = readback.check(run)
    result["missing_s"] = (killed - started).total_seconds() - result["seconds"]
    listed = json.loads(subprocess.run([binary, "runs", "--out", str(out), "--json"], capture_output=True, check=True).stdout)
    state = next(entry["state"] for entry in listed["runs"] if Path(entry["run_dir"]) == run)
    if state != "interrupted":
        result["problems"].append(f"listed as {state}")
    recovered = subprocess.run([binary, "recover", str(run), "--json"], capture_output=True)
    if recovered.returncode != 0:
        result["problems"].append(f"recover: {recovered.stderr.decode()}")
    elif json.loads(recovered.stdout)["samples"] != result["rows"]:
        result["problems"].append("recover counts other rows")
    after = readback.check(run)
    result["problems"] += after["problems"]
    if after["state"] != "interrupted":
        result["problems"].append(f"after recover: {after['state']}")
    return result


def main() -> int:
    if len(sys.argv) < 2:
        print(__doc__)
        return 2
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 5
    moments = random.Random(int(sys.argv[3]) if len(sys.argv) > 3 else 1)
    with tempfile.TemporaryDirectory() as folder:
        # A folder a run: three at a time tell their own run from the others'.
        work = [(Path(folder) / f"runs-{i}", moments.uniform(0.0, 4.0)) for i in range(count)]
        with ThreadPoolExecutor(3) as pool:
            results = list(pool.map(lambda each: kill_once(sys.argv[1], *each), work))
    for result in results:
        print(json.dumps(result))
    worst = max(result["missing_s"] for result in results)
    wrong = [result for result in results if result["problems"]]
    print(f"{count} kills: {len(wrong)} with problems, at most {worst:.3f} s missing (allowed {LONGEST_MISSING_S} s)")
    return 1 if wrong or worst > LONGEST_MISSING_S else 0


if __name__ == "__main__":
    sys.exit(main())
