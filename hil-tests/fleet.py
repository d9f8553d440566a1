#!/usr/bin/env python3
"""Asks a tree of 500 runs for its peaks in `runs query`, DuckDB and Dask; all must agree.

Usage: fleet.py SHAKETABLE [RUNS]       prints a line a check; exit code 1 when one is wrong.

One simulated run is put into the tree by `export --tree`; the others are copies of its steps with peaks of their own.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas

CASES = ["B0-0.03", "B1-G2-0.05", "B3-G3-0.04", "B4-G1-0.03"]


def call(*words: str) -> str:
    # The Python beside this one answers SQL where there is no `duckdb` program.
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    return subprocess.run(words, check=True, capture_output=True, text=True, env=os.environ | {"PATH": path}).stdout


def grown(shaketable: str, folder: Path, runs: int) -> Path:
    """The tree, and what is in it by pandas."""
    made = json.loads(call(shaketable, "run", "--steps", "1.0..1.4", "--out", str(folder / "runs"), "--json"))
    tree = folder / "fleet"
    call(shaketable, "export", made["run_dir"], "--tree", str(tree))
    [first] = (tree / "steps").glob("*/*/*/steps.parquet")
    steps = pandas.read_parquet(first, partitioning=None)
    random = np.random.default_rng(7)
    for run in range(1, runs):
        place = tree / "steps" / f"date=2025-{1 + run % 12:02}-{1 + run % 28:02}" / f"case={CASES[run % 4]}" / f"run=r{run:04}"
        place.mkdir(parents=True)
        own = pandas.concat([steps] * max(1, 92 // len(steps)), ignore_index=True)
        own["index"] = np.arange(len(own), dtype=float)
        own["a_max_m_s2"] *= random.uniform(0.5, 2.0, len(own))
        own["excursion_m"] *= random.uniform(0.5, 2.0, len(own))
        own.to_parquet(place / "steps.parquet", index=False)
    return tree


def peaks_by_duckdb(tree: Path) -> pandas.DataFrame:
    import duckdb
    return duckdb.sql(f"""
        select date::varchar as date, "case", run, direction, count(*) as steps,
               arg_max(frequency_hz, a_max_m_s2) as frequency_hz,
               max(a_max_m_s2) as a_max_m_s2, max(excursion_m) as excursion_m
        from read_parquet('{tree}/steps/**/*.parquet', hive_partitioning = true) group by all""").df()


def main() -> int:
    shaketable, runs = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 500
    folder = Path(tempfile.mkdtemp())
    wrong = 0

    def check(name: str, holds: bool, said: str = "") -> None:
        nonlocal wrong
        wrong += not holds
        print(f"{'ok   ' if holds else 'WRONG'} {name} {said}")

    try:
        tree = grown(shaketable, folder, runs)
        keys = ["date", "case", "run", "direction"]
        began = time.perf_counter()
        said = json.loads(call(shaketable, "runs", "query", str(tree), "--peaks", "--json"))
        wall = time.perf_counter() - began
        own = pandas.DataFrame(said["rows"], columns=said["columns"]).sort_values(keys).reset_index(drop=True)
        check("all runs are read", said["runs"] == runs, f"{runs} runs, {len(own)} peaks in {wall:.3f} s")
        other = peaks_by_duckdb(tree).sort_values(keys).reset_index(drop=True)
        same = own[keys].astype(str).equals(other[keys].astype(str))
        figures = ["steps", "frequency_hz", "a_max_m_s2", "excursion_m"]
        same = same and all(np.array_equal(own[c].to_numpy(float), other[c].to_numpy(float)) for c in figures)
        check("peaks are those of DuckDB", same)
        few = json.loads(call(shaketable, "runs", "query", str(tree), "--where", "case=B3-*", "--where",
                              "date>=2025-06-01", "--where", "frequency_hz<1.25", "--json"))
        import duckdb
        [(count,)] = duckdb.sql(f"""select count(*) from read_parquet('{tree}/steps/**/*.parquet', hive_partitioning = true)
            where "case" like 'B3-%' and date >= '2025-06-01' and frequency_hz < 1.25""").fetchall()
        check("conditions select what DuckDB selects", len(few["rows"]) == count and count > 0, f"{count} steps")
        sql = json.loads(call(shaketable, "runs", "query", str(tree), "--json", "--sql",
                              'select "case", max(a_max_m_s2) as top from steps group by all order by all'))
        tops = {row["case"]: row["top"] for row in sql["rows"]}
        import dask.dataframe
        lazy = dask.dataframe.read_parquet(str(tree / "steps"))
        found = lazy.groupby("case", observed=True).a_max_m_s2.max().compute()
        check("Dask and SQL agree", tops == {str(k): float(v) for k, v in found.items()}, f"{len(tops)} cases")
        samples = json.loads(call(shaketable, "runs", "query", str(tree), "--json", "--sql",
                                  "select count(*) as n, max(abs(relative_displacement_m)) as d from samples"))
        check("samples are there for SQL", samples["rows"][0]["n"] > 1000, str(samples["rows"][0]))
    finally:
        shutil.rmtree(folder)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
