"""The daemon's interface against its own description: generated requests, among them many that are wrong.

usage: api.py SHAKETABLE SCHEMATHESIS

Asserted: no answer of 500 or above, no status and no content that the description does not name. A recorded run is
there to be asked about, and operations on it are tried as on names that do not exist.
"""

import json
import os
import subprocess
import sys
import tempfile
import urllib.request

CHECKS = "not_a_server_error,status_code_conformance,content_type_conformance,response_schema_conformance"


def main(shaketable: str, schemathesis: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        runs = os.path.join(folder, "runs")
        command = [shaketable, "run", "--steps", "4.8..5.0", "--out", runs, "--json"]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        run = os.path.basename(json.loads(done.stdout)["run_dir"])
        serve = [shaketable, "serve", "--listen", "127.0.0.1:0", "--sweep", "quick", "--out", runs]
        daemon = subprocess.Popen(serve, stdout=subprocess.PIPE, text=True)
        try:
            address = daemon.stdout.readline().strip()
            config = os.path.join(folder, "schemathesis.toml")
            with open(config, "w", encoding="utf-8") as file:
                # A generated name is no run; without one nothing behind it would be reached.
                file.write(f'[parameters]\n"path.id" = "{run}"\n')
            # The live view is a WebSocket.
            command = [
                schemathesis, f"--config-file={config}", "run", f"{address}/api/openapi.json", "--checks", CHECKS,
                "--max-examples", "20", "--exclude-path", "/api/v1/live", "--workers", "1", "--continue-on-failure",
            ]
            tried = subprocess.run(command, check=False)
            with urllib.request.urlopen(f"{address}/api/v1/status", timeout=10) as answer:
                state = json.load(answer)["state"]
            print(f"the bench is {state} afterwards")
            if tried.returncode != 0:
                sys.exit(tried.returncode)
        finally:
            daemon.terminate()
            try:
                daemon.wait(timeout=60)
            except subprocess.TimeoutExpired:
                # Nothing is left behind for what comes next, and the failure told.
                daemon.kill()
                raise


if __name__ == "__main__":
    main(*sys.argv[1:])
