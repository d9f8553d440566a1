#!/usr/bin/env python3
"""Two tables publish through nats-server; a subscriber of another make compares what arrives with the records.

Usage: publish.py SHAKETABLE [NATS-SERVER]      prints a line a run; exit code 1 when something is wrong.

quiet      no publication, the rest as below: what this machine and this test do to two runs at once
shared     both tables on one server, logged in by a secrets file: every line of events.jsonl and of steps.csv arrives, the
           live data are the smallest and largest values of the recorded rows, and a subscriber that reads nothing is
           the server's trouble alone
frozen     the server of one table (over TLS) stands still during the run: frames are dropped and counted, the lines
           arrive complete once it goes on
restarted  the server of the other is killed and started anew during the run: a stream on its disk holds every line once

In all of them the runs end as done, no sample is lost, the record is whole. A run that the supervisor ended because this
machine stood still gets two more chances. Slips are printed beside those of runs without publication: on a shared machine
that is a figure, no verdict.
"""

import asyncio
import csv
import json
import os
import signal
import socket
import ssl
import struct
import subprocess
import sys
import tempfile
import time
import urllib.request
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import nats
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import readback  # noqa: E402

TABLES = {"east": 1, "west": 64}
# Gentle, so that a busy machine does not end the runs.
SWEEP = {"frequencies_hz": [4.0, 5.0], "cycles": 12, "direction": "forward-backward", "acceleration_g": 0.005}
CHANNELS = [
    "table_displacement_m", "table_acceleration_m_s2", "mass_acceleration_m_s2", "relative_displacement_m",
    "model_acceleration_m_s2", "model_displacement_m", "command_displacement_m", "command_acceleration_m_s2",
]
SECRET = "nobody-must-read-this-in-a-log"


async def wait_for(condition, what: str, limit_s: float = 60.0):
    end = time.monotonic() + limit_s
    while not (value := condition()):
        if time.monotonic() > end:
            raise AssertionError(f"waited {limit_s} s for {what}")
        await asyncio.sleep(0.02)
    return value


def free_port() -> int:
    with socket.socket() as any_port:
        any_port.bind(("127.0.0.1", 0))
        return any_port.getsockname()[1]


class Server:
    """A nats-server with a configuration of its own."""

    def __init__(self, program: str, folder: Path, name: str, extra: str):
        self.port, self.monitor = free_port(), free_port()
        self.command = [program, "-c", str(folder / f"{name}.conf")]
        text = f"listen: 127.0.0.1:{self.port}\nhttp: 127.0.0.1:{self.monitor}\n{extra}\n"
        (folder / f"{name}.conf").write_text(text)
        self.log = open(folder / f"{name}.log", "a", encoding="utf-8")
        self.process = None

    async def start(self):
        self.process = subprocess.Popen(self.command, stdout=self.log, stderr=self.log)
        await wait_for(self.listens, "nats-server", 20)

    def listens(self) -> bool:
        assert self.process.poll() is None, f"nats-server ended: {Path(self.log.name).read_text()}"
        with socket.socket() as knock:
            return knock.connect_ex(("127.0.0.1", self.port)) == 0

    def numbers(self) -> dict:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.monitor}/varz", timeout=10) as answer:
            return json.load(answer)

    def end(self):
        if self.process:
            self.process.send_signal(signal.SIGCONT)
            self.process.kill()
            self.process.wait()
        self.log.close()


class Table:
    """A daemon on a simulated rig."""

    def __init__(self, shaketable: str, folder: Path, name: str, cpu: int, publish: str | None):
        self.shaketable, self.name, self.out = shaketable, name, folder / f"runs-{name}"
        self.before_s = self.run_cpu_s = 0.0
        command = [shaketable, "serve", "--listen", "127.0.0.1:0", "--out", str(self.out), "--cpu", str(cpu)]
        if publish:
            path = folder / f"{name}.toml"
            path.write_text(publish)
            command += ["--publish", str(path), "--table", name]
        self.said = open(folder / f"{name}.log", "a", encoding="utf-8")
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=self.said, text=True)
        self.address = self.process.stdout.readline().strip()

    def ask(self, path: str, method: str = "GET", body=None):
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self.address + path, data=data, method=method)
        request.add_header("content-type", "application/json")
        with urllib.request.urlopen(request, timeout=20) as answer:
            text = answer.read().decode()
        return json.loads(text) if path.startswith("/api") else text

    def set_up(self):
        self.ask("/api/v1/setup/sweep", "PUT", SWEEP)

    def start(self) -> None:
        command = [self.shaketable, "start", "--confirm", "--url", self.address, "--json"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr

    def status(self) -> dict:
        return self.ask("/api/v1/status")

    def cpu_s(self) -> float:
        # The name in parentheses may hold blanks; user and system time are the 12th and 13th word behind it.
        words = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")

    def publication(self) -> dict:
        return self.ask("/api/v1/health")["publication"]

    def end(self):
        if self.process.poll() is None:
            self.process.terminate()
            self.process.wait(timeout=60)
        self.said.close()


@dataclass
class Seen:
    """What a subscriber has got of one table."""

    lines: dict = field(default_factory=lambda: {"events": {}, "steps": {}})
    frames: list = field(default_factory=list)
    status: list = field(default_factory=list)
    twice: int = 0

    def events(self) -> int:
        return sum(len(told) for told in self.lines["events"].values())

    def take(self, message):
        topic = message.subject.split(".")[2]
        if topic == "live":
            self.frames.append(((message.headers or {}).get("Shaketable-Run"), message.data))
            return
        told = json.loads(message.data)
        assert told["table"] == message.subject.split(".")[1], message.subject
        if topic == "status":
            self.status.append(told)
            return
        known = self.lines[topic].setdefault(told["run"], {})
        if told["number"] in known:
            assert known[told["number"]] == told, "another message under the same number"
            self.twice += 1
        known[told["number"]] = told


async def subscribe(port: int, seen: dict, **options):
    """Everything of all tables, through a connection that comes back by itself."""
    async def take(message):
        seen.setdefault(message.subject.split(".")[1], Seen()).take(message)

    async def quiet(_):
        pass

    client = await nats.connect(
        f"nats://127.0.0.1:{port}", reconnect_time_wait=0.05, max_reconnect_attempts=-1, error_cb=quiet, **options)
    await client.subscribe("shaketable.>", cb=take)
    await client.flush()
    return client


def reads_nothing(port: int, login: dict) -> socket.socket:
    """A subscriber of everything, and of `filler`, that never reads."""
    deaf = socket.socket()
    deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    deaf.connect(("127.0.0.1", port))
    deaf.sendall(b"CONNECT " + json.dumps({"verbose": False, "headers": True} | login).encode() + b"\r\nSUB shaketable.> 1\r\nSUB filler 2\r\n")
    return deaf


def head(frame: bytes) -> dict:
    names = ["magic", "version", "kind", "width", "points", "factor", "run", "first", "dropped", "zero"]
    return dict(zip(names, struct.unpack_from("<4B3IQ2I", frame)))


def compare_lines(run: Path, told: dict, topic: str) -> int:
    """Numbers without a gap, and the same content as the file."""
    if topic == "events":
        wanted = [json.loads(line) for line in (run / "events.jsonl").read_text().splitlines()]
        assert [told[n]["event"] for n in sorted(told)] == wanted, "events differ from events.jsonl"
    else:
        with open(run / "steps.csv", newline="", encoding="utf-8") as file:
            wanted = list(csv.DictReader(file))
        steps = [told[n]["step"] for n in sorted(told)]
        assert len(steps) == len(wanted), f"{len(steps)} steps, {len(wanted)} in steps.csv"
        for step, row in zip(steps, wanted):
            flat = {key: value for key, value in step.items() if not isinstance(value, list)}
            for channel, unit in [("table_acceleration", "m_s2"), ("mass_acceleration", "m_s2"), ("relative_displacement", "m")]:
                for order, harmonic in enumerate(step[channel], 1):
                    flat[f"{channel}_h{order}_{unit}"] = harmonic["amplitude"]
                    flat[f"{channel}_h{order}_phase_rad"] = harmonic["phase_rad"]
            for key, text in row.items():
                value = flat[key]
                assert value == (text if isinstance(value, str) else float(text)), f"{key}: {value}, in steps.csv {text}"
    assert sorted(told) == list(range(len(wanted))), "numbers with a gap"
    return len(wanted)


def compare_frames(run: Path, frames: list, factor: int) -> tuple[int, int, int]:
    """Every pair of points is the smallest and largest value of the rows that it stands for. Returns rows shown, rows that
    no frame shows between the first and the last, frames dropped as the last one tells."""
    with h5py.File(run / "samples.h5", "r") as file:
        rows = file["samples"][:]
    columns = {name: rows[name] for name in CHANNELS if name in rows.dtype.names}
    columns["mass_acceleration_m_s2"] = 0.5 * (rows["mass_acceleration_1_m_s2"] + rows["mass_acceleration_2_m_s2"])
    start, shown, missing, after, dropped = int(rows["sequence"][0]), 0, 0, None, 0
    for name, frame in frames:
        if name != run.name:
            continue
        told = head(frame)
        assert (told["magic"], told["version"], told["kind"], told["factor"]) == (0x53, 1, 0, factor), told
        points = np.frombuffer(frame, "<f4", offset=32).reshape(told["width"], told["points"])
        count = told["points"] if factor == 1 else told["points"] // 2 * factor
        at = told["first"] - start
        for channel, values in zip(CHANNELS, points):
            measured = columns[channel][at:at + count].astype(np.float32).reshape(-1, factor)
            low, high = (values, values) if factor == 1 else (values[0::2], values[1::2])
            assert np.array_equal(low, measured.min(axis=1)) and np.array_equal(high, measured.max(axis=1)), \
                f"{channel} from row {told['first']} on is not the envelope of what was recorded"
        missing += 0 if after is None else told["first"] - after
        after, shown, dropped = told["first"] + count, shown + count, told["dropped"]
    return shown, missing, dropped


def compare_run(table: Table, seen: Seen | None) -> dict:
    """The record by itself, then against what was seen."""
    ended = table.status()["ended"]
    run = table.out / ended["id"]
    found = {"table": table.name, "outcome": ended["outcome"], "lost": ended["lost_samples"], "slips": ended["slips"], "rows": ended["samples"]}
    found["cpu s"] = round(table.run_cpu_s, 2)
    found["step p99.9 us"] = round(ended["timing"]["step"]["p999_us"], 1)
    problems = readback.check(run)["problems"]
    assert not problems, problems
    assert ended["lost_samples"] == 0, ended
    if seen:
        found["events"] = compare_lines(run, seen.lines["events"].get(run.name, {}), "events")
        found["steps"] = compare_lines(run, seen.lines["steps"].get(run.name, {}), "steps")
        found["rows shown"], found["not shown"], found["dropped"] = compare_frames(run, seen.frames, TABLES[table.name])
        assert found["rows shown"] > 0 and (found["not shown"] == 0 or found["dropped"] > 0), found
        found["twice"] = seen.twice
    return found


async def run_all(tables: list, meanwhile=None) -> None:
    """Starts every table, does something meanwhile, waits for the ends."""
    for table in tables:
        table.set_up()
    for table in tables:
        table.before_s = table.cpu_s()
        await asyncio.to_thread(table.start)
    if meanwhile:
        await meanwhile()
    for table in tables:
        await wait_for(lambda: table.status()["state"] in ("stopped", "aborted"), "the end of the run", 120)
        table.run_cpu_s = table.cpu_s() - table.before_s


async def told_all(table: Table, seen: Seen, fetch=None) -> dict:
    """Waits until the server has confirmed every line and as many events as there are have arrived, or were fetched."""
    events = table.out / table.status()["ended"]["id"] / "events.jsonl"
    end = time.monotonic() + 30
    while True:
        if fetch:
            await fetch()
        publication = table.publication()
        if publication["connected"] and publication["waiting_bytes"] == 0 and seen.events() >= events.read_text().count("\n"):
            return publication
        assert time.monotonic() < end, f"waited 30 s for the last lines of {table.name}: {publication}"
        await asyncio.sleep(0.05)


def spec(port: int, name: str, extra: str = "", scheme: str = "nats") -> str:
    return f'server = "{scheme}://127.0.0.1:{port}"\nlive_rows = {TABLES[name]}\n{extra}'


def metric(table: Table, name: str) -> float:
    lines = table.ask("/metrics").splitlines()
    return float(next(line for line in lines if line.startswith(f"shaketable_publication_{name} ")).split()[1])


async def quiet(shaketable: str, program: str, folder: Path) -> list:
    return await shared(shaketable, program, folder, False)


async def shared(shaketable: str, program: str, folder: Path, published: bool = True) -> list:
    login = {"user": "tables", "pass": SECRET}
    server = Server(program, folder, "shared", (
        'write_deadline: "200ms"\nmax_payload: 65536\nmax_pending: 65536\n'
        f"authorization {{ users = [ {{ user: tables, password: {SECRET} }} ] }}"))
    secrets = folder / "secrets.toml"
    secrets.write_text(f'user = "tables"\npassword = "{SECRET}"\n')
    secrets.chmod(0o600)
    await server.start()
    tables, seen, client, deaf = [], {}, None, None
    try:
        deaf = reads_nothing(server.port, login)
        client = await subscribe(server.port, seen, user="tables", password=SECRET)
        for cpu, name in enumerate(TABLES):
            publish = spec(server.port, name, f'credentials = "{secrets}"\n') if published else None
            tables.append(Table(shaketable, folder, name, cpu, publish))

        async def fill():
            # The kernel holds megabytes for a socket that nobody reads: as much as many tables send in a while.
            for _ in range(1000):
                await client.publish("filler", bytes(60_000))
                await client.flush()
                if server.numbers()["slow_consumers"]:
                    return
            raise AssertionError("the subscriber that reads nothing was not noticed by the server")

        await run_all(tables, fill)
        if not published:
            return [compare_run(table, None) for table in tables]
        publications = [await told_all(table, seen[table.name]) for table in tables]
        found = [compare_run(table, seen[table.name]) for table in tables]
        for table, publication in zip(tables, publications):
            assert publication["connections"] == 1 and publication["resent"] == 0, publication
            assert metric(table, "connected") == 1 and metric(table, "frames_dropped") == publication["frames_dropped"]
            told = seen[table.name].status[-1]
            assert told["status"]["setup"]["simulated"] and told["publication"]["table"] == table.name
        return found
    finally:
        if client:
            await client.close()
        if deaf:
            deaf.close()
        for table in tables:
            table.end()
        server.end()


def certificate(folder: Path) -> tuple[Path, Path]:
    chain, key = folder / "server.pem", folder / "server.key"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2",
         "-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1", "-addext", "basicConstraints=critical,CA:FALSE",
         "-keyout", str(key), "-out", str(chain)], check=True, capture_output=True)
    return chain, key


async def disturbed(shaketable: str, program: str, folder: Path) -> list:
    chain, key = certificate(folder)
    frozen = Server(program, folder, "frozen", f'tls {{ cert_file: "{chain}", key_file: "{key}" }}')
    restarted = Server(program, folder, "restarted", f'jetstream {{ store_dir: "{folder / "streams"}" }}')
    tables, seen, clients = [], {}, []
    try:
        await frozen.start()
        await restarted.start()
        trust = ssl.create_default_context(cafile=str(chain))
        clients.append(await subscribe(frozen.port, seen, tls=trust, tls_hostname="localhost"))
        clients.append(await subscribe(restarted.port, seen))
        streams = clients[1].jetstream()
        await streams.add_stream(name="tables", subjects=["shaketable.*.events", "shaketable.*.steps"])
        publish = [spec(frozen.port, "east", f'trust = "{chain}"\n', "tls"), spec(restarted.port, "west")]
        tables = [Table(shaketable, folder, name, cpu, text) for cpu, (name, text) in enumerate(zip(TABLES, publish))]
        east, west = tables

        async def disturb():
            # Each in the middle of the run: after its first frames, before its end.
            await wait_for(lambda: all(len(seen[name].frames) > 20 for name in TABLES if name in seen) and len(seen) == 2, "frames")
            frozen.process.send_signal(signal.SIGSTOP)
            restarted.process.kill()
            restarted.process.wait()
            await wait_for(lambda: not west.publication()["connected"], "the loss of the killed server")
            await wait_for(lambda: not east.publication()["connected"], "the loss of the server that stands still")
            for table in tables:
                publication = table.publication()
                assert publication["error"] and publication["frames_dropped"] > 0, publication
                # One that the supervisor has ended is told below, and tried again.
                assert table.status()["state"] in ("running", "stopping", "aborted"), "the run was over before the disturbance was"
            frozen.process.send_signal(signal.SIGCONT)
            await restarted.start()

        await run_all(tables, disturb)
        # The subscriber of the killed server was away as well; the stream on the server's disk was not.
        stored, held = Seen(), 0

        async def fetch():
            nonlocal held
            last = (await streams.stream_info("tables")).state.last_seq
            for held in range(held + 1, last + 1):
                stored.take(await streams.get_msg("tables", seq=held))

        publications = [await told_all(east, seen["east"]), await told_all(west, stored, fetch)]
        assert stored.twice == 0, "the stream holds a message twice"
        seen_alive = sum(len(told) for topic in seen["west"].lines.values() for told in topic.values())
        stored.frames = seen["west"].frames
        found = [compare_run(east, seen["east"]), compare_run(west, stored)]
        found[1]["in the stream"], found[1]["seen by the subscriber that was away"] = held, seen_alive
        for table, publication, one in zip(tables, publications, found):
            done = one["outcome"] == "done"
            assert publication["connections"] >= 2 and (not done or one["not shown"] > 0 and one["dropped"] > 0), (publication, one)
            assert metric(table, "frames_dropped") == table.publication()["frames_dropped"] >= one["dropped"]
            one["resent"] = publication["resent"]
        return found
    finally:
        for client in clients:
            await client.close()
        for table in tables:
            table.end()
        frozen.end()
        restarted.end()


def refusals(shaketable: str) -> None:
    """Wrong files end the daemon before it listens, and no secret in them is repeated."""
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        path, secrets = folder / "wrong.toml", folder / "secrets.toml"
        secrets.write_text(f'user = "tables"\npassword = "{SECRET}"\n')
        secrets.chmod(0o644)
        fine = 'server = "nats://127.0.0.1:4222"\n'
        for text, name, word in [
            (f'server = "nats://tables:{SECRET}@127.0.0.1"\n', "east", "credentials"),
            (f'server = "nats://tables:{SECRET}@127.0.0.1"\nliverows = 3\n', "east", "liverows"),
            (f'{fine}credentials = "{secrets}"\n', "east", "0600"),
            (fine, "east.live", "letters"),
        ]:
            path.write_text(text)
            command = [shaketable, "serve", "--listen", "127.0.0.1:0", "--out", str(folder), "--publish", str(path), "--table", name]
            done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
            said = done.stdout + done.stderr
            assert done.returncode == 2 and word in said and SECRET not in said, (done.returncode, said)


async def main() -> int:
    if len(sys.argv) < 2:
        print(__doc__)
        return 2
    shaketable = sys.argv[1]
    program = sys.argv[2] if len(sys.argv) > 2 else "nats-server"
    os.environ["PATH"] += ":/usr/sbin:/sbin"
    refusals(shaketable)
    usual = await measured("quiet", quiet, shaketable, program)
    for name, part in [("shared", shared), ("disturbed", disturbed)]:
        for chance in (3, 2, 1):
            found = await measured(name, part, shaketable, program)
            if all(one["outcome"] == "done" for one in found):
                break
            print(f"{name}: a run was ended" + ("; once more" if chance > 1 else ", three times"))
            if chance == 1:
                return 1
        slips, before = (max(one["slips"] for one in ones) for ones in (found, usual))
        print(f"{name}: at most {slips} slips a table, {before} without publication", flush=True)
    return 0


async def measured(name: str, part, shaketable: str, program: str) -> list:
    """Makes the runs of a part in a folder of their own and prints what was found."""
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        found = await part(shaketable, program, folder)
        logs = "".join(path.read_text(errors="replace") for path in folder.glob("*.log"))
    assert SECRET not in logs, "a secret stands in a log"
    for one in found:
        print(name, json.dumps(one), flush=True)
    return found


if __name__ == "__main__":
    sys.exit(asyncio.run(main()))
