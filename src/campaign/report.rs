//! The report of a campaign: one self-contained page, every figure as an SVG of its own, every table as CSV.

use super::CampaignError;
use super::design_map::DesignMap;
use super::figures::{self, Against, Figure};
use super::peaks::{CasePeaks, Contact, LogError, rms};
use super::store::{CaseResult, Store, write_whole};
use super::tables::{Origin, Problem, Study};
use crate::record::{RunFolder, RunState, folder};
use crate::report::{Chart, HeatMap, Page, Table, of_run};
use std::path::PathBuf;

/// What a report consists of, and where it was written.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Written {
    /// The page.
    pub page: PathBuf,
    /// Figures on their own.
    pub figures: Vec<PathBuf>,
    /// Tables.
    pub tables: Vec<PathBuf>,
}

/// A heat map with its name and caption.
pub type NamedMap = (String, HeatMap, String);

/// Every figure of the study, in the order of the page.
pub fn all_figures(study: &Study) -> Vec<Figure> {
    let mut all = Vec::new();
    for problem in Problem::ALL {
        for against in Against::ALL {
            for origin in origins(study) {
                all.extend(figures::ratios(study, origin, problem, against));
            }
        }
        all.extend(origins(study).into_iter().map(|origin| figures::trade_off(study, origin, problem)));
    }
    all
}

/// Heat maps with their names and captions: against the published table where there is one, and the onboard
/// model against what was measured.
pub fn all_maps(study: &Study) -> Vec<NamedMap> {
    let pairs = [
        (Origin::Measured, Origin::Published, "Measured in this campaign against the published table"),
        (Origin::Model, Origin::Published, "Onboard model against the published table"),
        (Origin::Model, Origin::Measured, "Onboard model against what was measured in this campaign"),
    ];
    let map = |(origin, against, what): (Origin, Origin, &str)| {
        let errors: Vec<LogError> = study.errors(origin, against).into_iter().map(|(_, e)| e).collect();
        let caption = format!(
            "{what}: logarithmic error of each cell, RMS {:.1} % over {} cells.",
            100.0 * rms(&errors),
            errors.len()
        );
        let name = match against {
            Origin::Measured => "error-model-measured".to_owned(),
            _ => format!("error-{}", origin.name()),
        };
        (!errors.is_empty()).then(|| (name, figures::error_map(study, origin, against), caption))
    };
    pairs.into_iter().filter_map(map).collect()
}

fn origins(study: &Study) -> Vec<Origin> {
    let there = |origin: &Origin| study.of(*origin).iter().any(|peaks| peaks.forward.is_some());
    Origin::ALL.into_iter().filter(there).collect()
}

/// Writes page, figures and tables into the folder of a campaign, with the design map where there is one.
///
/// # Errors
/// [`CampaignError`] when there is no result, or a file cannot be written.
pub fn write(
    store: &Store,
    study: &Study,
    results: &[CaseResult],
    designs: Option<&DesignMap>,
) -> Result<Written, CampaignError> {
    if results.is_empty() {
        return Err(CampaignError::Empty { path: store.path().to_owned() });
    }
    let folder = |name: &str| -> Result<PathBuf, CampaignError> {
        let path = store.path().join(name);
        std::fs::create_dir_all(&path).map_err(|error| CampaignError::file(&path, error))?;
        Ok(path)
    };
    let (figures_at, tables_at) = (folder("figures")?, folder("tables")?);
    let mut written =
        Written { page: store.path().join("report.html"), figures: Vec::new(), tables: Vec::new() };
    for (name, text) in [
        ("peaks.csv", study.peaks_csv()),
        ("normalised.csv", study.normalised_csv()),
        ("errors.csv", study.errors_csv()),
    ] {
        let path = tables_at.join(name);
        write_whole(&path, &text)?;
        written.tables.push(path);
    }
    let all = all_figures(study);
    for figure in &all {
        let path = figures_at.join(format!("{}.svg", figure.name));
        write_whole(&path, &figure.chart.svg()?)?;
        written.figures.push(path);
    }
    let maps = all_maps(study);
    for (name, map, _) in &maps {
        let path = figures_at.join(format!("{name}.svg"));
        write_whole(&path, &map.svg()?)?;
        written.figures.push(path);
    }
    page(store, study, results, (&all, &maps, designs))?.write(&written.page)?;
    Ok(written)
}

fn page(
    store: &Store,
    study: &Study,
    results: &[CaseResult],
    (all, maps, designs): (&[Figure], &[NamedMap], Option<&DesignMap>),
) -> Result<Page, CampaignError> {
    let spec = &study.configuration.spec;
    let mut page = Page::new(&format!("Campaign {}", spec.name));
    let done = study.measured.iter().filter(|peaks| peaks.forward.is_some()).count();
    page.text(&format!(
        "{done} of {} cases measured on the rig `{}`, {} run(s) a case.",
        study.configuration.cases.len(),
        study.configuration.rig.name,
        spec.repeats
    ));
    for result in results.iter().filter(|result| result.state() != "done") {
        page.note(&format!("{}: {}.", result.case, result.state()));
    }
    for result in results.iter().filter(|result| result.lost_samples > 0) {
        page.note(&format!("{}: {} samples were lost.", result.case, result.lost_samples));
    }
    page.section("Table 2: peaks of every case");
    page.text("Upward sweep. Grazing: the excursion is within -3 and +6 % of the total gap, so that small changes decide. Intervals are 95 % of one run, from repeats of the case or from cases that repeat free flight.");
    page.table(&peaks_table(study));
    page.folded_table("Downward sweep", &backward_table(study));
    if !maps.is_empty() {
        page.section("Where model and measurement fail");
        for (_, map, caption) in maps {
            page.drawing(&map.inline_svg()?, caption);
        }
    }
    let of = |prefix: &str| -> Vec<(&Chart, &str)> {
        let wanted = all.iter().filter(|figure| figure.name.starts_with(prefix));
        wanted.map(|figure| (&figure.chart, figure.caption.as_str())).collect()
    };
    for problem in Problem::ALL {
        page.section(match problem {
            Problem::First => "First problem: displacements, against free flight",
            Problem::Second => "Second problem: accelerations, against the most rigid bumper",
        });
        for against in Against::ALL {
            let prefix = format!("figure-{}-", figures::number(problem, against));
            page.figures(&of(&prefix))?;
        }
        let prefix = format!("trade-off-{}-", problem.name());
        page.figures(&of(&prefix))?;
        page.table(&choices_table(study, problem));
    }
    if let Some(designs) = designs {
        page.section("Design map: between and beyond what was tried");
        page.text(&designs.about());
        for (_, map, caption) in designs.figures() {
            page.drawing(&map.inline_svg()?, &caption);
        }
        page.table(&designs.summary());
    }
    showcases(store, study, results, &mut page)?;
    let text = toml::to_string(spec).map_err(|error| CampaignError::file(store.path(), error))?;
    page.folded_text("Campaign file", &text);
    Ok(page)
}

fn peaks_table(study: &Study) -> Table {
    let mut table = Table::new([
        "case",
        "nu_R",
        "A_max (m/s2)",
        "95 %",
        "E_max (mm)",
        "95 %",
        "contact",
        "model: nu_R",
        "A_max",
        "E_max",
        "published: nu_R",
        "A_max",
        "E_max",
    ]);
    for (i, case) in study.configuration.cases.iter().enumerate() {
        let measured = &study.measured[i];
        let mut cells = vec![case.label.clone()];
        match measured.forward {
            Some(p) => {
                let ci = |pick: fn(&super::peaks::Confidence) -> f64, value: f64| {
                    measured
                        .confidence
                        .map_or("-".to_owned(), |c| format!("+-{value:.2}", value = pick(&c) * value))
                };
                cells.extend([
                    format!("{:.2}", p.nu_r),
                    format!("{:.2}", p.a_max_m_s2),
                    ci(|c| c.a_max, p.a_max_m_s2),
                    format!("{:.1}", p.excursion_m * 1e3),
                    ci(|c| c.excursion, p.excursion_m * 1e3),
                    contact(measured),
                ]);
            }
            None => {
                cells.extend(["-", "-", "-", "-", "-"].map(str::to_owned));
                cells.push(measured.state.clone());
            }
        }
        for origin in [Origin::Model, Origin::Published] {
            cells.extend(three(study.forward(origin, i)));
        }
        table.push(cells);
    }
    table
}

fn three(peaks: Option<super::peaks::Peaks>) -> [String; 3] {
    match peaks {
        Some(p) => {
            [format!("{:.2}", p.nu_r), format!("{:.2}", p.a_max_m_s2), format!("{:.1}", p.excursion_m * 1e3)]
        }
        None => ["-", "-", "-"].map(str::to_owned),
    }
}

fn contact(peaks: &CasePeaks) -> String {
    match peaks.contact {
        Some(Contact::Free) => "no bumpers",
        Some(Contact::Clear) => "clear",
        Some(Contact::Grazing) => "grazing",
        Some(Contact::Full) => "full",
        None => "-",
    }
    .to_owned()
}

fn backward_table(study: &Study) -> Table {
    let mut table = Table::new([
        "case",
        "nu_R",
        "A_max (m/s2)",
        "E_max (mm)",
        "model nu_R",
        "model A_max",
        "model E_max",
    ]);
    for ((case, measured), model) in study.configuration.cases.iter().zip(&study.measured).zip(&study.model) {
        let cells =
            [case.label.clone()].into_iter().chain(three(measured.backward)).chain(three(model.backward));
        table.push(cells);
    }
    table
}

fn choices_table(study: &Study, problem: Problem) -> Table {
    let mut table = Table::new(["", "robust choice", "worst eta + alpha", "Pareto front"]);
    for origin in origins(study) {
        let name = origin.name();
        for level in study.levels_g() {
            let choices = study.trade_off(origin, problem, level);
            // 0.07 g has no free flight to compare with.
            if !choices.is_empty() {
                let front: Vec<String> =
                    choices.into_iter().filter(|c| c.on_front).map(|c| c.device).collect();
                table.push([format!("{name}, {level} g"), String::new(), String::new(), front.join(" ")]);
            }
        }
        if let Some(robust) = study.robust(origin, problem, &[]) {
            let worst = format!("{:.2}", robust.worst_sum);
            table.push([format!("{name}, over all A_G"), robust.device, worst, String::new()]);
        }
    }
    table
}

/// Command, histories, pseudo-resonance curves, loops and portraits of the cases that the file names.
fn showcases(
    store: &Store,
    study: &Study,
    results: &[CaseResult],
    page: &mut Page,
) -> Result<(), CampaignError> {
    let listed = folder::list(&store.runs()).unwrap_or_default();
    for label in &study.configuration.spec.showcase {
        let result = results.iter().find(|result| result.case == *label && !result.steps.is_empty());
        let Some(result) = result else { continue };
        let of_it = |(path, read): &folder::Listed| {
            let (manifest, state) = read.as_ref().ok()?;
            let same = manifest.samples_sha256 == result.samples_sha256 && *state == RunState::Done;
            same.then(|| path.clone())
        };
        page.section(&format!("Figures 9 to 14: {label}"));
        let Some(path) = listed.iter().find_map(of_it) else {
            page.text("Its run folder is not here (it was run elsewhere); the report in that folder has these figures.");
            continue;
        };
        let run =
            RunFolder::open(&path).map_err(|error| CampaignError::file(&path, error)).and_then(|folder| {
                of_run::report(&folder, &result.steps).map_err(|error| CampaignError::file(&path, error))
            })?;
        run.paper_figures(page)?;
    }
    Ok(())
}
