#!/usr/bin/env python3
"""Exports a record in every format and reads each back with an independent reader.

Usage: exports.py SHAKETABLE [RECORD]       prints a line a format; exit code 1 when one is wrong.

Readers: pandas and DuckDB (Parquet), pandas (CSV) and tomllib (its sidecar), h5py (HDF5, MAT v7.3), pyuff
(UFF58). A reader that is not installed is named and counts as failed, so that nothing passes unread.
Without RECORD a stepped sine with odd numbers in it is made.
"""

import subprocess
import sys
import tempfile
import tomllib
from importlib.metadata import version
from pathlib import Path

import numpy as np

# Newer pandas reads every digit by default.
EXACT = {} if int(version("pandas").split(".")[0]) >= 3 else {"float_precision": "round_trip"}
UNITS = {"time_s": "s", "table_displacement_m": "m", "table_acceleration_m_s2": "m/s2",
         "mass_acceleration_1_m_s2": "m/s2", "mass_acceleration_2_m_s2": "m/s2",
         "relative_displacement_m": "m", "force_n": "N", "displacement_m": "m",
         "acceleration_m_s2": "m/s2", "step": "1"}


def made(path: Path) -> None:
    """Three steps with values down to 1e-300 and of 17 digits."""
    import pandas
    rate, random = 2048.0, np.random.default_rng(5)
    hz = np.repeat([1.0, 1.3, 1.7], 20480)
    phase = 2 * np.pi * np.cumsum(hz) / rate
    n = len(hz)
    acceleration = 0.5 * np.sin(phase)
    relative = 0.004 * np.sin(phase - 0.7) + 1e-5 * random.standard_normal(n)
    relative[7] = 1.2345678901234567e-300
    pandas.DataFrame({
        "time_s": np.arange(n) / rate,
        "table_displacement_m": -acceleration / (2 * np.pi * hz) ** 2,
        "table_acceleration_m_s2": acceleration,
        "mass_acceleration_1_m_s2": acceleration - (2 * np.pi * hz) ** 2 * 0.004 * np.sin(phase - 0.7),
        "mass_acceleration_2_m_s2": acceleration - (2 * np.pi * hz) ** 2 * 0.004 * np.sin(phase - 0.7),
        "relative_displacement_m": relative,
        "step": np.repeat([0, 1, 2], 20480).astype(np.int32),
    }).to_parquet(path)


def frame(table) -> dict:
    return {name: np.asarray(table[name]) for name in table}


def plain_parquet(path: Path) -> dict:
    import pandas
    return frame(pandas.read_parquet(path))


def parquet_pandas(path: Path) -> dict:
    import pyarrow.parquet
    said = pyarrow.parquet.read_metadata(path).metadata
    table = plain_parquet(path)
    units = {name: said[f"unit:{name}".encode()].decode() for name in table if name != "step"}
    assert units == {name: UNITS[name] for name in units}, f"units {units}"
    assert said[b"kind"] == b"base", f"kind {said[b'kind']}"
    return table


def parquet_duckdb(path: Path) -> dict:
    import duckdb
    return dict(duckdb.sql(f"select * from read_parquet('{path}')").fetchnumpy())


def csv(path: Path) -> dict:
    import pandas
    sidecar = tomllib.loads(Path(f"{path}.toml").read_text())
    units = {column["name"]: column["unit"] for column in sidecar["columns"]}
    table = frame(pandas.read_csv(path, **EXACT))
    assert units == {name: UNITS[name] for name in table}, f"units {units}"
    return table


def hdf5(path: Path) -> dict:
    import h5py
    with h5py.File(path) as file:
        for name, data in file.items():
            assert name == "step" or data.attrs["unit"].decode() == UNITS[name], f"unit of {name}"
        return {name: data[:] for name, data in file.items()}


def mat(path: Path) -> dict:
    import h5py
    with h5py.File(path) as file:
        for name in file:
            assert "MATLAB_class" in file[name].attrs, f"{name} has no MATLAB class"
        for name, data in file["unit"].items():
            unit = "".join(map(chr, data[:].ravel()))
            assert unit == UNITS[name], f"unit of {name}: {unit}"
        return {name: file[name][:].ravel() for name in file if name in UNITS}


def uff(path: Path) -> dict:
    import pyuff
    sets = pyuff.UFF(str(path)).read_sets()
    for one in sets:
        name, unit = one["id1"].strip(), one["ordinate_axis_units_lab"].strip()
        assert unit == UNITS[name], f"unit of {name}: {unit}"
    table = {one["id1"].strip(): np.asarray(one["data"]) for one in sets}
    table["time_s"] = np.asarray(sets[0]["x"])
    return table


def tree(binary: str, folder: Path) -> str:
    """Two runs in one tree, read by pandas and DuckDB as a table with its partitions."""
    import duckdb
    import pandas
    runs, fleet = folder / "runs", folder / "fleet"
    for case in ("B1-G2-0.05", "B2-G2-0.05"):
        subprocess.run([binary, "run", "--case", case, "--steps", "2.0..2.2", "--out", runs], check=True, capture_output=True)
    for run in runs.iterdir():
        subprocess.run([binary, "export", run, "--tree", fleet], check=True, capture_output=True)
    expected = {}
    for run in runs.iterdir():
        steps = pandas.read_csv(run / "steps.csv", **EXACT)
        expected[run.name] = steps
    columns = list(next(iter(expected.values())).columns)
    query = f"select * from read_parquet('{fleet}/steps/**/*.parquet', hive_partitioning = true) order by \"index\""
    for name, table in (("DuckDB", duckdb.sql(query).df()), ("pandas", pandas.read_parquet(fleet / "steps"))):
        assert {"date", "case", "run"} <= set(table.columns), f"{name}: partitions {list(table.columns)}"
        for run, steps in expected.items():
            found = table[table["run"].astype(str) == run].sort_values("index")
            assert len(found) == len(steps), f"{name}: {len(found)} steps of {run}"
            for column in columns:
                same = found[column].to_numpy() == steps[column].to_numpy()
                assert same.all(), f"{name}: {column} of {run} differs"
    rows = duckdb.sql(f"select run, count(*) n from read_parquet('{fleet}/samples/**/*.parquet', hive_partitioning = true) group by run").df()
    for run in runs.iterdir():
        said = tomllib.loads((run / "run.toml").read_text())["samples"]
        found = int(rows[rows["run"] == run.name]["n"].iloc[0])
        assert found == said, f"{run.name}: {found} rows in the tree, {said} recorded"
    return f"tree by pandas and DuckDB: {len(expected)} runs, steps and rows equal"


FORMATS = [("a.parquet", parquet_pandas, 0.0), ("a.parquet", parquet_duckdb, 0.0), ("a.csv", csv, 0.0),
           ("a.h5", hdf5, 0.0), ("a.mat", mat, 0.0), ("a.uff", uff, 1e-12)]


def main() -> int:
    binary = sys.argv[1]
    failed = False
    with tempfile.TemporaryDirectory() as folder:
        source = Path(sys.argv[2]) if len(sys.argv) > 2 else Path(folder) / "source.parquet"
        if len(sys.argv) < 3:
            made(source)
        # The record as the product sees it, by a reader that is judged by the others.
        reference = None
        for name, reader, tolerance in FORMATS:
            path = Path(folder) / name
            label = f"{name.split('.')[1]} by {reader.__name__}"
            try:
                subprocess.run([binary, "export", source, "-o", path, "--force"], check=True, capture_output=True)
                table = reader(path)
                if reference is None:
                    reference = table
                    original = plain_parquet(source) if source.suffix == ".parquet" else table
                    for column in set(original) & set(table):
                        assert np.array_equal(original[column], table[column]), f"{column} is not the source's"
                assert set(table) == set(reference), f"columns {sorted(table)}"
                for column, values in reference.items():
                    other = table[column]
                    assert len(other) == len(values), f"{column}: {len(other)} samples"
                    # The format keeps the interval to six digits and the values to thirteen.
                    relative = 5e-6 if column == "time_s" and tolerance else tolerance
                    assert np.all(np.abs(other - values) <= relative * np.abs(values)), f"{column} differs"
                print(f"{label}: {len(reference)} columns of {len(values)} equal")
            except (AssertionError, ImportError, KeyError, subprocess.CalledProcessError) as error:
                failed = True
                print(f"{label}: FAILED {error}")
        try:
            print(tree(binary, Path(folder)))
        except (AssertionError, ImportError, KeyError, subprocess.CalledProcessError) as error:
            failed = True
            print(f"tree: FAILED {error}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
