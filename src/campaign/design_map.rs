//! The design map of a campaign as it is kept beside its results, drawn, and put into the report.
//!
//! `campaign optimise` makes it and writes it; `campaign report` shows the one that is there.

use super::CampaignError;
use super::optimise::{Design, Map, Optimum, Space};

use super::report::NamedMap;
use super::store::{Store, write_whole};
use crate::report::{HeatMap, Table};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// File in the campaign's folder.
const FILE: &str = "design-map.json";

/// What was mapped, from what, and what came out.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct DesignMap {
    /// Whose peaks the model was identified on.
    pub origin: String,
    /// Effects added to the model of the campaign.
    pub effects: Vec<String>,
    /// What was looked at.
    pub space: Space,
    /// What came out.
    pub optimum: Optimum,
}

impl DesignMap {
    /// The map that is kept in a campaign's folder, if there is one.
    ///
    /// # Errors
    /// [`CampaignError::File`] when it cannot be read.
    pub fn kept(store: &Store) -> Result<Option<Self>, CampaignError> {
        let path = store.path().join(FILE);
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(CampaignError::file(&path, error)),
        };
        serde_json::from_str(&text).map(Some).map_err(|error| CampaignError::file(&path, error))
    }

    /// Keeps the map, its figures and its table in the campaign's folder: what was written.
    ///
    /// # Errors
    /// [`CampaignError`] when a file cannot be written.
    pub fn write(&self, store: &Store) -> Result<Vec<PathBuf>, CampaignError> {
        let folder = |name: &str| -> Result<PathBuf, CampaignError> {
            let path = store.path().join(name);
            std::fs::create_dir_all(&path).map_err(|error| CampaignError::file(&path, error))?;
            Ok(path)
        };
        let (figures, tables) = (folder("figures")?, folder("tables")?);
        let mut files = Vec::new();
        for (name, map, _) in self.figures() {
            files.push(figures.join(format!("{name}.svg")));
            write_whole(&files[files.len() - 1], &map.svg()?)?;
        }
        let text = serde_json::to_string(self).map_err(|error| CampaignError::file(store.path(), error))?;
        for (path, text) in [(tables.join("design-map.csv"), self.csv()), (store.path().join(FILE), text)] {
            write_whole(&path, &text)?;
            files.push(path);
        }
        Ok(files)
    }

    /// The map of every problem: name, drawing, caption.
    pub fn figures(&self) -> Vec<NamedMap> {
        let one = |map: &Map| {
            let caption = format!(
                "{} problem: worst sum eta + alpha over the table accelerations ({}) that free flight and the rigid bumper were run at, in per cent, as the model predicts it.",
                capital(map.problem.name()),
                map.levels_g.iter().map(|g| format!("{g} g")).collect::<Vec<_>>().join(", ")
            );
            (format!("design-map-{}", map.problem.name()), heat_map(map, &self.space), caption)
        };
        self.optimum.maps.iter().map(one).collect()
    }

    /// What the map was made from, in a sentence.
    pub fn about(&self) -> String {
        let with = match self.effects.join(", ") {
            none if none.is_empty() => String::new(),
            names => format!(" with {names}"),
        };
        format!(
            "The campaign's model{with}, identified on the {} peaks to {:.1} % (RMS), predicts bumpers and gaps between and beyond those tried. The damping of a bumper that does not exist is {:.2e} times its stiffness to the power {:.2}. Intervals come from {} models drawn from the covariance of the fit: they hold the numbers of the model, not effects that it lacks.",
            self.origin,
            100.0 * self.optimum.rms,
            self.optimum.damping_law[0],
            self.optimum.damping_law[1],
            self.optimum.draws
        )
    }

    /// The best design and the best tried device of both problems.
    pub fn summary(&self) -> Table {
        let mut table = Table::new([
            "problem",
            "",
            "stiffness (kN/m)",
            "total gap (mm)",
            "worst eta + alpha",
            "95 %",
            "better in",
            "",
        ]);
        for map in &self.optimum.maps {
            for design in [&map.best, &map.best_tried] {
                let interval = design.worst_sum_95.map(|[low, high]| format!("{low:.2} to {high:.2}"));
                let share = design.better_than_tried.map(|share| format!("{:.0} % of models", 100.0 * share));
                let border = design.device.is_none() && map.at_border;
                table.push([
                    map.problem.name().to_owned(),
                    design.device.clone().unwrap_or_else(|| "best of the map".to_owned()),
                    format!("{:.0}", 1e-3 * design.stiffness_n_m),
                    format!("{:.1}", 1e3 * design.total_gap_m),
                    format!("{:.2}", design.worst_sum),
                    interval.unwrap_or_default(),
                    share.unwrap_or_default(),
                    match (design.beyond, border) {
                        (_, true) => "at the border of the map".to_owned(),
                        (true, _) => "beyond what was tried".to_owned(),
                        _ => String::new(),
                    },
                ]);
            }
        }
        table
    }

    /// Every design under every table acceleration.
    pub fn csv(&self) -> String {
        let mut out = String::from(
            "problem,device,stiffness_n_m,damping_n_s_m,total_gap_m,beyond,table_acceleration_g,eta,alpha\n",
        );
        for map in &self.optimum.maps {
            for design in map.tried.iter().chain(&map.designs) {
                for (level_g, [eta, alpha]) in map.levels_g.iter().zip(&design.ratios) {
                    out += &format!(
                        "{},{},{},{},{},{},{level_g},{eta},{alpha}\n",
                        map.problem.name(),
                        design.device.as_deref().unwrap_or_default(),
                        design.stiffness_n_m,
                        design.damping_n_s_m,
                        design.total_gap_m,
                        design.beyond
                    );
                }
            }
        }
        out
    }
}

/// Worst sum of both ratios by stiffness and gap, per cent.
fn heat_map(map: &Map, space: &Space) -> HeatMap {
    let columns: Vec<String> = space.stiffness_n_m.iter().map(|k| format!("{:.0}", 1e-3 * k)).collect();
    let row = |designs: &[Design]| designs.iter().map(|d| Some(100.0 * d.worst_sum)).collect();
    let values: Vec<Vec<Option<f64>>> = map.designs.chunks(columns.len().max(1)).map(row).collect();
    let full = values.iter().flatten().flatten().fold(0.0_f64, |top, v| top.max(*v));
    HeatMap {
        rows: space.total_gap_m.iter().map(|gap| format!("{:.1} mm", 1e3 * gap)).collect(),
        groups: vec![(
            format!("{} problem: worst eta + alpha (%) by bumper stiffness (kN/m)", map.problem.name()),
            columns,
            values,
        )],
        full,
        one_sided: true,
        decimals: 0,
    }
}

fn capital(name: &str) -> String {
    let mut letters = name.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::tables::Problem;

    fn design(device: Option<&str>, stiffness_n_m: f64, total_gap_m: f64, eta: f64) -> Design {
        Design {
            device: device.map(str::to_owned),
            stiffness_n_m,
            damping_n_s_m: 300.0,
            total_gap_m,
            beyond: false,
            ratios: vec![[eta, 1.5]],
            worst_sum: eta + 1.5,
            worst_sum_95: Some([2.0, 2.5]),
            better_than_tried: Some(0.75),
        }
    }

    fn map() -> DesignMap {
        let designs =
            [0.015, 0.020].iter().flat_map(|gap| [20e3, 40e3].map(|k| design(None, k, *gap, 1e-5 * k)));
        let tried = design(Some("B1-G1"), 33e3, 0.015, 0.9);
        let map = Map {
            problem: Problem::First,
            levels_g: vec![0.05],
            designs: designs.collect(),
            tried: vec![tried.clone()],
            best_tried: tried,
            best: design(None, 20e3, 0.015, 0.2),
            at_border: true,
        };
        let optimum = Optimum { rms: 0.06, damping_law: [0.1, 0.75], draws: 60, maps: vec![map] };
        let space =
            Space { stiffness_n_m: vec![20e3, 40e3], total_gap_m: vec![0.015, 0.020], ..Space::default() };
        DesignMap { origin: "published".into(), effects: vec!["coulomb-friction".into()], space, optimum }
    }

    #[test]
    fn what_is_kept_is_read_back_and_every_design_is_drawn_and_listed() {
        let folder = tempfile::tempdir().expect("folder");
        let store = Store::at(folder.path());
        assert!(DesignMap::kept(&store).expect("nothing there").is_none());
        let map = map();
        let files = map.write(&store).expect("written");
        assert!(files.len() == 3 && files.iter().all(|file| file.is_file()), "{files:?}");
        let kept = DesignMap::kept(&store).expect("read").expect("there");
        assert_eq!(kept.optimum.maps[0].designs, map.optimum.maps[0].designs);
        assert_eq!(
            (kept.space.stiffness_n_m, kept.effects),
            (map.space.stiffness_n_m.clone(), map.effects.clone())
        );
        let rows: Vec<String> = map.csv().lines().map(str::to_owned).collect();
        assert_eq!(rows.len(), 1 + 1 + 4);
        assert_eq!(rows[1], "first,B1-G1,33000,300,0.015,false,0.05,0.9,1.5");
        let (name, drawing, _) = &map.figures()[0];
        assert_eq!(name, "design-map-first");
        let cell = |row: usize, column: usize| drawing.groups[0].2[row][column];
        let sums = [cell(0, 0), cell(0, 1), cell(1, 1)].map(|value| value.expect("a cell").round());
        assert_eq!(sums, [170.0, 190.0, 190.0]);
        assert!(
            map.about().contains("with coulomb-friction") && map.about().contains("6.0 %"),
            "{}",
            map.about()
        );
        std::fs::write(folder.path().join(FILE), "{}").expect("written");
        assert!(DesignMap::kept(&store).is_err());
    }
}
