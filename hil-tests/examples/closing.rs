//! Closes the loop through the program itself, effect by effect: the simulated table carries a specimen with a hidden effect, the
//! base model is on board; run, compare, diagnose, add what was found, run again. Prints a line an effect (tab separated) and ends
//! with an error when the onboard model is not within 1.5 times the noise floor at the end.
//!
//! `cargo run --release -p hil-tests --example closing -- target/release/shaketable --seed 4000 [--size 0.08] [--only NAME] [--keep FOLDER]`

use hil_tests::arguments;
use hil_tests::hidden::{self, Recipe};
use serde_json::Value;
use shaketable::model::{ModelSpec, effects};
use std::path::{Path, PathBuf};
use std::process::Command;

type Failure = Box<dyn std::error::Error>;

/// Live error over the noise floor that the last model has to reach.
const NEAR: f64 = 1.5;

struct Bench {
    program: String,
    folder: PathBuf,
}

impl Bench {
    fn ask(&self, words: &[&str]) -> Result<Value, Failure> {
        let output = Command::new(&self.program).args(words).current_dir(&self.folder).output()?;
        if !output.status.success() {
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            return Err(format!("{}: {} {said}", words.join(" "), output.status).into());
        }
        Ok(serde_json::from_slice(&output.stdout)?)
    }

    fn write(&self, name: &str, model: &ModelSpec) -> Result<(), Failure> {
        Ok(std::fs::write(self.folder.join(name), toml::to_string(model)?)?)
    }

    /// Runs a coarse sweep with a model on board: folder, live error over the floor, live error.
    fn run(&self, model: &str) -> Result<(String, f64, f64), Failure> {
        let sweep = ["--sweep", "sweep.toml", "--specimen", "specimen.toml", "--out", "runs", "--json"];
        let said = self.ask(&[&["run", "--model", model], sweep.as_slice()].concat())?;
        let run = said["run_dir"].as_str().ok_or("no run folder")?.to_owned();
        let compared = self.ask(&["compare", &run, "--model", model, "--json"])?;
        let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
        let (live, floor) = (&said["error"], &compared["error"]);
        let over = [("nrmse_a", "noise_floor_a"), ("nrmse_d", "noise_floor_d")]
            .map(|(error, noise)| number(&live[error]) / number(&floor[noise]));
        Ok((run, over[0].max(over[1]), number(&live["nrmse_a"])))
    }

    fn close(&self, name: &str, seed: u64, size: f64) -> Result<bool, Failure> {
        let Some(case) = hidden::make(&Recipe::of(seed, &[name_of(name)?], size)) else {
            println!("{name}\tnot reached");
            return Ok(true);
        };
        self.write("specimen.toml", &case.truth)?;
        self.write("base.toml", &case.nominal)?;
        let (first, before, error) = self.run("base.toml")?;
        let found = self.ask(&["diagnose", &first, "--model", "base.toml", "--json"])?;
        // The numbers of the base model are re-fitted together with what is added.
        let names: Vec<String> = found["effects"]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(|effect| effect["name"].as_str().map(str::to_owned))
            .collect();
        let mut model = "base.toml".to_owned();
        for (i, effect) in names.iter().enumerate() {
            let next = format!("added-{i}.toml");
            self.ask(&[
                "effect", "add", effect, "--model", &model, "--fit", &first, "-o", &next, "--force", "--json",
            ])?;
            model = next;
        }
        let instrument = |name: &String| effects::find(name).is_ok_and(|effect| effect.is_instrument());
        if names.iter().any(instrument) || names.is_empty() && found["verdict"] == "adequate" {
            // What the re-fitted numbers take up is closed by them, and an instrument is added without a fit of the rest.
            let fitted = "re-fitted.toml".to_owned();
            self.ask(&["identify", &first, "--model", &model, "-o", &fitted, "--json"])?;
            model = fitted;
        }
        let (_, after, error_after) = self.run(&model)?;
        // Noise of the table's accelerometer drives the onboard model: near a jump of the response the truth is off as well.
        let (_, truth, _) = self.run("specimen.toml")?;
        println!(
            "{name}\t{}\t[{}]\tlive A {:.2} % -> {:.2} %\tover the floor {before:.2} -> {after:.2}, the truth on board {truth:.2}\t{}",
            found["verdict"].as_str().unwrap_or("?"),
            names.join(", "),
            100.0 * error,
            100.0 * error_after,
            if after < NEAR { "ok" } else { "NOT CLOSED" }
        );
        Ok(after < NEAR)
    }
}

fn name_of(name: &str) -> Result<&'static str, Failure> {
    hidden::studied()
        .into_iter()
        .find(|known| *known == name)
        .ok_or_else(|| format!("no effect {name}").into())
}

fn main() -> Result<(), Failure> {
    let mut words = std::env::args().skip(1);
    let program = words.next().ok_or("the program's path is missing")?;
    let program = Path::new(&program).canonicalize()?.display().to_string();
    let (mut seed, mut size, mut only, mut keep) = (4000, 0.08, None, None);
    arguments::each(words, |word, value| {
        match word {
            "--seed" => seed = value.parse()?,
            "--size" => size = value.parse()?,
            "--only" => only = Some(value),
            "--keep" => keep = Some(PathBuf::from(value)),
            _ => return Ok(false),
        }
        Ok(true)
    })?;
    let fleeting = tempfile::tempdir()?;
    let folder = keep.unwrap_or_else(|| fleeting.path().to_owned());
    std::fs::create_dir_all(&folder)?;
    let bench = Bench { program, folder };
    let sweep = "start_hz = 0.6\nstop_hz = 4.2\nstep_hz = 0.2\ncycles = 10\nacceleration_g = 0.04\n";
    std::fs::write(bench.folder.join("sweep.toml"), sweep)?;
    let names = hidden::studied().into_iter().filter(|name| only.as_ref().is_none_or(|only| only == name));
    let mut open = Vec::new();
    for (i, name) in names.enumerate() {
        match bench.close(name, seed + i as u64, size) {
            Ok(true) => {}
            Ok(false) => open.push(name),
            Err(error) => {
                println!("{name}\t{error}");
                open.push(name);
            }
        }
    }
    if open.is_empty() { Ok(()) } else { Err(format!("not closed: {}", open.join(", ")).into()) }
}
