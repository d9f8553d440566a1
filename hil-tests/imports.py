#!/usr/bin/env python3
"""Imports files that other programs wrote, whole and damaged, and looks at what becomes of them.

Usage: imports.py SHAKETABLE        prints a line a case; exit code 1 when one is wrong.

Writers: pandas (CSV, Parquet), h5py (HDF5, and MAT v7.3 as MATLAB lays it out), pyuff (UFF58). The truth is
the motion itself, which is known at every instant.
"""

import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np
import pandas

G = 9.80665
# The address space a child may use: enough for every case here, and far below the largest file.
MEMORY_BYTES = 3 << 30


def motion(t):
    """Table acceleration (m/s2), mass acceleration (m/s2), relative displacement (m): steps of 2, 3 and 4 Hz
    of 5 s each, half a second of rest between them."""
    a = np.zeros_like(t)
    m, d = np.zeros_like(t), np.zeros_like(t)
    for k, hz in enumerate((2.0, 3.0, 4.0)):
        at = t - 5.5 * k
        inside = (at >= 0) & (at < 5.0)
        w = 2 * np.pi * hz
        a = np.where(inside, 0.5 * np.sin(w * at), a)
        d = np.where(inside, 0.004 * np.sin(w * at - 0.6), d)
        m = np.where(inside, a - w * w * 0.004 * np.sin(w * at - 0.6), m)
    return a, m, d


def foreign(t):
    a, m, d = motion(t)
    return pandas.DataFrame({"t (ms)": 1e3 * t, "acc T": a / G, "acc M": -m / G, "laser": 1e3 * d})


MAP = ["--map", "time=t (ms):ms", "--map", "table_acceleration=acc T:g",
       "--map", "mass_acceleration_1=-acc M:g", "--map", "relative_displacement=laser:mm"]

TOML = """
kind = "base"
[[columns]]
name = "t (ms)"
role = "time_s"
unit = "ms"
[[columns]]
name = "acc T"
role = "table_acceleration_m_s2"
unit = "g"
[[columns]]
name = "acc M"
role = "mass_acceleration_1_m_s2"
unit = "g"
sign = -1
[[columns]]
name = "laser"
role = "relative_displacement_m"
unit = "mm"
"""


def run(binary, source, *options):
    """Imports into Parquet. Gives exit code, what was said, the table (or None) and the JSON."""
    out = source.parent / "out.parquet"
    limit = lambda: resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))  # noqa: E731
    done = subprocess.run([binary, "import", source, "-o", out, "--force", "--json", *options],
                          capture_output=True, text=True, preexec_fn=limit, timeout=300)
    if done.returncode != 0:
        assert done.returncode in (1, 2), f"exit code {done.returncode}: {done.stderr[-300:]}"
        assert "panicked" not in done.stderr, done.stderr[-300:]
        assert source.name in done.stderr or "mapping" in done.stderr, f"no file in: {done.stderr[-300:]}"
        return done.returncode, done.stderr, None, {}
    said = json.loads(done.stdout)
    return 0, done.stderr + " ".join(said["notes"]), pandas.read_parquet(out), said


def is_motion(table, tolerance=1e-12, start=0.0, inside=None):
    t = table["time_s"].to_numpy()
    a, m, d = motion(t - start)
    keep = np.ones(len(t), bool) if inside is None else inside(t - start)
    for name, truth, size in (("table_acceleration_m_s2", a, 0.5), ("mass_acceleration_1_m_s2", m, 3.0),
                              ("relative_displacement_m", d, 0.004)):
        worst = np.abs(table[name].to_numpy() - truth)[keep].max()
        assert worst <= tolerance * size, f"{name} off by {worst}"


def has_steps(table, rate):
    steps = table["step"].to_numpy()
    assert set(steps) == {-1, 0, 1, 2}, f"steps {set(steps)}"
    for k in range(3):
        at = table["time_s"].to_numpy()[steps == k]
        assert at[0] >= 5.5 * k - 2 / rate and at[-1] <= 5.5 * k + 5.0 + 2 / rate, f"step {k}: {at[0]}..{at[-1]}"
        assert at[-1] - at[0] > 3.4, f"step {k} lasts {at[-1] - at[0]} s"


T = np.arange(int(16.5 * 1000)) / 1000.0


def by_map(binary, folder):
    path = folder / "foreign.csv"
    foreign(T).to_csv(path, index=False, float_format="%.17g")
    code, said, table, report = run(binary, path, *MAP)
    assert code == 0, said
    assert report["sample_rate_hz"] == 1000.0 and report["kind"] == "base", report
    is_motion(table)
    has_steps(table, 1000)
    return "CSV in g, mm and ms, one sign turned, 1000 Hz, three steps found"


def by_toml(binary, folder):
    (folder / "columns.toml").write_text(TOML)
    path = folder / "foreign.parquet"
    foreign(T).to_parquet(path)
    code, said, table, _ = run(binary, path, "--columns", folder / "columns.toml")
    assert code == 0, said
    is_motion(table)
    return "Parquet described by a TOML"


def hdf5_other_rate(binary, folder):
    path, t = folder / "foreign.h5", np.arange(int(16.5 * 512)) / 512.0
    with h5py.File(path, "w") as file:
        group = file.create_group("run 7")
        table = foreign(t)
        for name in table:
            group.create_dataset(name, data=table[name].to_numpy(), compression="gzip")
    code, said, table, report = run(binary, path, *MAP)
    assert code == 0 and report["sample_rate_hz"] == 512.0, said
    is_motion(table)
    return "HDF5 by h5py, in a group, gzip, 512 Hz"


def mat(binary, folder):
    path = folder / "foreign.mat"
    a, m, d = motion(T)
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in (("accT", a), ("accM", m), ("laser", d)):
            data = file.create_dataset(name, data=values.reshape(1, -1))
            data.attrs["MATLAB_class"] = np.bytes_("double")
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    code, said, table, report = run(binary, path, "--map", "table_acceleration=accT", "--map", "mass_acceleration_1=accM",
                                    "--map", "relative_displacement=laser", "--rate", "1000")
    assert code == 0, said
    is_motion(table)
    return "MAT v7.3 laid out as MATLAB does, rate given"


def uff(binary, folder):
    import pyuff
    path = folder / "foreign.uff"
    a, m, d = motion(T)
    for name, values, unit in (("accT", a, "m/s2"), ("accM", m, "m/s2"), ("laser", 1e3 * d, "mm")):
        data = pyuff.prepare_58(binary=0, func_type=1, id1=name, rsp_node=1, rsp_dir=1, ref_node=0, ref_dir=0,
                                abscissa_spacing=1,
                                abscissa_inc=1e-3, abscissa_min=0.0,
                                data=values, x=T, ordinate_spec_data_type=8, ordinate_axis_units_lab=unit,
                                abscissa_spec_data_type=17, abscissa_axis_units_lab="s", return_full_dict=True)
        # What the format wants and a signal has none of.
        texts = ("lab", "name", "id2", "id3", "id4", "id5")
        data = {key: ("NONE" if key.endswith(texts) else 0) if value is None else value for key, value in data.items()}
        pyuff.UFF(str(path)).write_sets(data, "add")
    code, said, table, report = run(binary, path, "--map", "table_acceleration=accT", "--map", "mass_acceleration_1=accM",
                                    "--map", "relative_displacement=laser")
    assert code == 0, said
    assert "converted" in said, said
    is_motion(table, 1e-4)
    return "UFF58 by pyuff, the unit mm read from the file"


def gaps(binary, folder):
    path = folder / "gaps.csv"
    table = foreign(T).drop(index=list(range(7000, 7040)) + list(range(9000, 9003)))
    table.to_csv(path, index=False, float_format="%.17g")
    code, said, table, _ = run(binary, path, *MAP)
    assert code == 0 and "43 samples missing" in said, said
    assert len(table) == len(T)
    whole = lambda t: ~(((t > 6.9995) & (t < 7.0395)) | ((t > 8.9995) & (t < 9.0025)))  # noqa: E731
    is_motion(table, 1e-12, inside=whole)
    return "43 samples of two gaps bridged and said"


def jitter(binary, folder):
    path = folder / "jitter.csv"
    t = T + 0.25e-3 * np.random.default_rng(3).uniform(-1, 1, len(T))
    foreign(t).to_csv(path, index=False, float_format="%.17g")
    code, said, table, report = run(binary, path, *MAP)
    assert code == 0 and "resampled" in said, said
    assert abs(report["sample_rate_hz"] / 1000 - 1) < 1e-5, report
    start = table["time_s"].iloc[0]
    # Away from the jumps at the ends of the steps the cubic is good to a millionth.
    smooth = lambda t: ((t % 5.5 > 0.01) & (t % 5.5 < 4.99)) & (t > 0.01) & (t < 16.4)  # noqa: E731
    assert abs(start) < 1e-3
    is_motion(table, 1e-5, inside=smooth)
    return "jitter of a quarter of an interval resampled and said"


def kinds(binary, folder):
    for kind, columns in (("force", "force_n"), ("component", "force_n")):
        path = folder / f"{kind}.csv"
        d = 0.01 * np.sin(2 * np.pi * 2 * T)
        pandas.DataFrame({"time_s": T, "displacement_m": d, columns: 100 * d}).to_csv(path, index=False)
        code, said, _, report = run(binary, path, "--kind", kind)
        assert code == 0 and report["kind"] == kind, said
    return "force and component"


def refused(binary, folder, name, content, *options, says):
    path = folder / name
    path.write_bytes(content)
    code, said, _, _ = run(binary, path, *options)
    assert code != 0, f"{name} was taken"
    assert says in said, f"{name}: {said[-300:]}"


def malformed(binary, folder):
    head = b"time_s,table_acceleration_m_s2,relative_displacement_m\n"
    rows = b"".join(b"%.6f,%.6f,%.6f\n" % (t, a, d) for t, a, d in zip(T, motion(T)[0], motion(T)[2]))
    refused(binary, folder, "empty.csv", b"", says="empty")
    refused(binary, folder, "head-only.csv", head, says="no numeric samples")
    refused(binary, folder, "missing.csv", b"time_s,relative_displacement_m\n0,1\n1,2\n", says="table_acceleration_m_s2")
    refused(binary, folder, "not-it.parquet", head + rows, says="name says")
    mostly = b"".join(line.rsplit(b",", 1)[0] + b",nan\n" if i % 5 else line
                      for i, line in enumerate(rows.splitlines(keepends=True)))
    refused(binary, folder, "nan.csv", head + mostly, says="no number")
    refused(binary, folder, "unit.csv", head + rows, "--map", "relative_displacement=relative_displacement_m:kg", says="no unit")
    refused(binary, folder, "column.csv", head + rows, "--map", "relative_displacement=laser", says="laser")
    path = folder / "few-nan.csv"
    path.write_bytes(head + b"".join(line if i % 5000 != 100 else line.split(b",")[0] + b",nan,nan\n"
                                     for i, line in enumerate(rows.splitlines(keepends=True))))
    code, said, _, _ = run(binary, path)
    assert code == 0 and "were no numbers" in said, said
    return "empty, headless, columnless, misnamed, mostly NaN, wrong unit: refused by name; some NaN: bridged and said"


def wrong_unit_and_sign(binary, folder):
    """Faults that nothing states: found by the kinematics."""
    table = foreign(T)
    for options, word in ((["--map", "mass_acceleration_1=acc M:g"], "sign"), (["--map", "relative_displacement=laser"], "unit")):
        path = folder / "fault.csv"
        table.to_csv(path, index=False, float_format="%.17g")
        given = [MAP[i:i + 2] for i in range(0, len(MAP), 2) if MAP[i + 1].split("=")[0] != options[1].split("=")[0]]
        code, said, _, _ = run(binary, path, *sum(given, []), *options)
        assert word in said.lower(), f"{options}: {said[-400:]}"
    return "swapped sign and forgotten unit are named"


def ten_gigabytes(binary, folder):
    lines = []
    for name, make in (("hole.csv", lambda p: foreign(T).to_csv(p, index=False)),
                       ("hole.parquet", lambda p: foreign(T).to_parquet(p))):
        path = folder / name
        make(path)
        with open(path, "r+b") as file:
            file.truncate(10 << 30)
        code, said, _, _ = run(binary, path, *MAP)
        assert code == 1, f"{name} was taken"
        lines.append(said.strip().splitlines()[-1].strip()[-60:])
    path = folder / "claim.h5"
    with h5py.File(path, "w") as file:
        for name in foreign(T[:2]):
            # Allocated but never written: ten gigabytes of zeros that the file really claims.
            file.create_dataset(name, shape=(10 << 30 >> 5,), dtype="f8")
            file[name].id.get_storage_size()
    code, said, _, _ = run(binary, path, *MAP)
    assert code == 1, f"{path.name} was taken"
    lines.append(said.strip().splitlines()[-1].strip()[-60:])
    return f"10 GB with a hole or a claim, within {MEMORY_BYTES >> 30} GB of address space: " + " | ".join(lines)


CASES = [by_map, by_toml, hdf5_other_rate, mat, uff, gaps, jitter, kinds, malformed, wrong_unit_and_sign, ten_gigabytes]


def main() -> int:
    if len(sys.argv) < 2:
        print(__doc__)
        return 2
    binary, failed = str(Path(sys.argv[1]).absolute()), False
    only = set(sys.argv[2:])
    for case in CASES:
        if only and case.__name__ not in only:
            continue
        with tempfile.TemporaryDirectory() as folder:
            try:
                print(f"{case.__name__}: {case(binary, Path(folder))}", flush=True)
            except (AssertionError, ImportError, KeyError, subprocess.SubprocessError) as error:
                failed = True
                print(f"{case.__name__}: FAILED {type(error).__name__} {error}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
