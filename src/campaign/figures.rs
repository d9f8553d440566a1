//! Figures 3 to 8 of the paper, the trade-off and the heat maps, from a [`Study`]. In the paper's legend the
//! colour is the bumper, the marker the gap, line style and marker size the table acceleration.

use super::tables::{Origin, Problem, Study};
use crate::report::{Chart, Dash, HeatMap, Ink, Marker, Stroke};

/// What a ratio is drawn against.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Against {
    /// Bumper, from free flight to the most rigid.
    Bumper,
    /// 1/G.
    InverseGap,
    /// Table acceleration.
    Acceleration,
}

impl Against {
    /// All, in the order of the paper's figures.
    pub const ALL: [Self; 3] = [Self::Bumper, Self::InverseGap, Self::Acceleration];

    fn name(self) -> &'static str {
        match self {
            Self::Bumper => "bumper",
            Self::InverseGap => "1/G",
            Self::Acceleration => "A_G",
        }
    }
}

/// One figure with its file name and caption.
pub struct Figure {
    /// `figure-3-eta-0-measured`.
    pub name: String,
    /// What it shows.
    pub caption: String,
    /// The plot.
    pub chart: Chart,
}

/// One point of a figure.
#[derive(Clone, Copy)]
struct Point {
    bumper: usize,
    gap: Option<usize>,
    level: usize,
    x: f64,
    y: f64,
}

fn bumper_ink(bumper: usize) -> Ink {
    // Free flight dark, the others in the further colours.
    if bumper == 0 { Ink::Measured } else { Ink::Other((bumper - 1) as u8) }
}

fn gap_marker(gap: Option<usize>) -> Marker {
    match gap.map(|gap| gap % 4) {
        None | Some(0) => Marker::Circle,
        Some(1) => Marker::Square,
        Some(2) => Marker::Triangle,
        Some(_) => Marker::Cross,
    }
}

fn level_stroke(ink: Ink, level: usize) -> Stroke {
    let (dash, width_px) = match level {
        0 => (Dash::Dotted, 1.2),
        1 => (Dash::Dashed, 1.2),
        2 => (Dash::Solid, 1.2),
        _ => (Dash::Solid, 2.4),
    };
    Stroke { ink, width_px, dash }
}

fn level_radius(level: usize) -> f64 {
    2.4 + 0.9 * level.min(4) as f64
}

/// Number of the paper's figure.
pub fn number(problem: Problem, against: Against) -> usize {
    let first = if problem == Problem::First { 3 } else { 6 };
    first + Against::ALL.iter().position(|a| *a == against).unwrap_or(0)
}

/// The two panels of one of figures 3 to 8 for one origin: in the first problem excursion first, in the second
/// acceleration first.
pub fn ratios(study: &Study, origin: Origin, problem: Problem, against: Against) -> Vec<Figure> {
    let (eta, alpha) = problem.symbols();
    let panels = match problem {
        Problem::First => [(eta, true), (alpha, false)],
        Problem::Second => [(alpha, false), (eta, true)],
    };
    let number = number(problem, against);
    panels
        .into_iter()
        .map(|(symbol, excursion)| Figure {
            name: format!("figure-{number}-{}-{}", symbol.replace('_', "-"), origin.name()),
            caption: format!(
                "{symbol} against {}, {}: {} over that {} (figure {number} of the paper).",
                against.name(),
                origin.name(),
                if excursion { "excursion" } else { "acceleration of the mass" },
                match problem {
                    Problem::First => "of free flight at the same A_G",
                    Problem::Second => "of the most rigid bumper at the same gap and A_G",
                }
            ),
            chart: panel(study, &points(study, origin, problem, against, excursion), against, symbol),
        })
        .collect()
}

fn points(study: &Study, origin: Origin, problem: Problem, against: Against, excursion: bool) -> Vec<Point> {
    let levels = study.levels_g();
    let configuration = &study.configuration;
    let point = |ratio: &super::tables::Ratio| {
        let case = &configuration.cases[ratio.case];
        let level = levels.iter().position(|level| (level - case.acceleration_g).abs() < 1e-9)?;
        let x = match against {
            Against::Bumper => case.bumper as f64,
            Against::InverseGap => 1e-3 / configuration.total_gap_m(case)?,
            Against::Acceleration => case.acceleration_g,
        };
        let y = if excursion { ratio.eta } else { ratio.alpha };
        Some(Point { bumper: case.bumper, gap: case.gap, level, x, y })
    };
    study.ratios(origin, problem).iter().filter_map(point).collect()
}

fn panel(study: &Study, points: &[Point], against: Against, symbol: &str) -> Chart {
    let spec = &study.configuration.spec;
    let x_label = match against {
        Against::Bumper => "Bumper",
        Against::InverseGap => "1/G (1/mm)",
        Against::Acceleration => "Table acceleration A_G (g)",
    };
    let mut chart = Chart::new(x_label, &format!("{symbol} (-)")).size(560.0, 400.0);
    if against == Against::Bumper {
        chart = chart.x_names(spec.bumper.iter().map(|bumper| bumper.name.clone()));
    }
    for line in lines(points, against) {
        let Some(first) = line.first() else { continue };
        let stroke = match against {
            // Along the bumpers no single colour holds; the line says the acceleration.
            Against::Bumper => level_stroke(Ink::Other(5), first.level),
            Against::InverseGap => level_stroke(bumper_ink(first.bumper), first.level),
            Against::Acceleration => Stroke::solid(bumper_ink(first.bumper)).width(1.0),
        };
        chart = chart.line(None, stroke, line.iter().map(|p| (p.x, p.y)).collect());
    }
    legend(study, marked(chart, points), points, against)
}

/// Every point by its case: bumper, gap and acceleration as in the paper's legend.
fn marked(mut chart: Chart, points: &[Point]) -> Chart {
    for p in points {
        let (ink, marker) = (bumper_ink(p.bumper), gap_marker(p.gap));
        chart = chart.points(None, ink, marker, level_radius(p.level), vec![(p.x, p.y)]);
    }
    chart
}

/// Points that belong to one line: all alike but in what the figure is drawn against.
fn lines(points: &[Point], against: Against) -> Vec<Vec<Point>> {
    let key = |p: &Point| match against {
        Against::Bumper => (usize::MAX, p.gap.unwrap_or(usize::MAX), p.level),
        Against::InverseGap => (p.bumper, usize::MAX, p.level),
        Against::Acceleration => (p.bumper, p.gap.unwrap_or(usize::MAX), usize::MAX),
    };
    let mut groups: Vec<((usize, usize, usize), Vec<Point>)> = Vec::new();
    for p in points {
        match groups.iter_mut().find(|(k, _)| *k == key(p)) {
            Some((_, group)) => group.push(*p),
            None => groups.push((key(p), vec![*p])),
        }
    }
    groups
        .into_iter()
        .map(|(_, mut group)| {
            group.sort_by(|a, b| a.x.total_cmp(&b.x));
            group
        })
        .filter(|group| group.len() > 1)
        .collect()
}

/// Entries without data: colour = bumper, marker = gap, line style and marker size = A_G.
fn legend(study: &Study, mut chart: Chart, points: &[Point], against: Against) -> Chart {
    let spec = &study.configuration.spec;
    for (i, bumper) in spec.bumper.iter().enumerate().filter(|(i, _)| points.iter().any(|p| p.bumper == *i)) {
        chart = chart.line(Some(&bumper.name), Stroke::solid(bumper_ink(i)).width(4.0), Vec::new());
    }
    for (i, gap) in spec.gap.iter().enumerate().filter(|(i, _)| points.iter().any(|p| p.gap == Some(*i))) {
        chart = chart.points(Some(&gap.name), Ink::Other(5), gap_marker(Some(i)), 4.0, Vec::new());
    }
    for (i, level) in
        study.levels_g().iter().enumerate().filter(|(i, _)| points.iter().any(|p| p.level == *i))
    {
        let label = format!("{level} g");
        chart = match against {
            Against::Acceleration => {
                chart.points(Some(&label), Ink::Other(5), Marker::Circle, level_radius(i), Vec::new())
            }
            _ => chart.line(Some(&label), level_stroke(Ink::Other(5), i), Vec::new()),
        };
    }
    chart
}

/// The trade-off of a problem: excursion against acceleration, the front of every acceleration joined.
pub fn trade_off(study: &Study, origin: Origin, problem: Problem) -> Figure {
    let (eta, alpha) = problem.symbols();
    let mut chart = Chart::new(&format!("{eta} (-)"), &format!("{alpha} (-)")).size(560.0, 420.0);
    let mut points = Vec::new();
    for (level, level_g) in study.levels_g().into_iter().enumerate() {
        let choices = study.trade_off(origin, problem, level_g);
        let mut front: Vec<(f64, f64)> = choices
            .iter()
            .filter(|choice| choice.on_front)
            .map(|choice| (choice.eta, choice.alpha))
            .collect();
        front.sort_by(|a, b| a.0.total_cmp(&b.0));
        chart = chart.line(None, level_stroke(Ink::Other(5), level), front);
        for choice in &choices {
            let case = study.configuration.cases.iter().find(|case| case.device == choice.device);
            let Some(case) = case else { continue };
            points.push(Point { bumper: case.bumper, gap: case.gap, level, x: choice.eta, y: choice.alpha });
        }
    }
    chart = marked(chart, &points);
    Figure {
        name: format!("trade-off-{}-{}", problem.name(), origin.name()),
        caption: format!(
            "Trade-off of the {} problem, {}: lines join the Pareto front of each table acceleration (low and left is better).",
            problem.name(),
            origin.name()
        ),
        chart: legend(study, chart, &points, Against::Bumper),
    }
}

/// Errors of one origin against another, per cent of ln: a group each for A_max, E_max and nu_R.
pub fn error_map(study: &Study, origin: Origin, against: Origin) -> HeatMap {
    let configuration = &study.configuration;
    let levels = study.levels_g();
    let mut rows: Vec<String> = Vec::new();
    for case in &configuration.cases {
        if !rows.contains(&case.device) {
            rows.push(case.device.clone());
        }
    }
    rows.sort();
    let errors = study.errors(origin, against);
    let group = |name: &str, pick: fn(&super::peaks::LogError) -> f64| {
        let mut values = vec![vec![None; levels.len()]; rows.len()];
        for (case, error) in &errors {
            let case = &configuration.cases[*case];
            let row = rows.iter().position(|row| *row == case.device);
            let level = levels.iter().position(|level| (level - case.acceleration_g).abs() < 1e-9);
            if let (Some(row), Some(level)) = (row, level) {
                values[row][level] = Some(100.0 * pick(error));
            }
        }
        (name.to_owned(), levels.iter().map(|level| format!("{level} g")).collect(), values)
    };
    HeatMap {
        groups: vec![
            group("A_max (ln, %)", |e| e.a_max),
            group("E_max (ln, %)", |e| e.excursion),
            group("nu_R (ln, %)", |e| e.nu_r),
        ],
        rows,
        full: 60.0,
        one_sided: false,
        decimals: 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::testing::published as study;

    fn attribute(element: &str, name: &str) -> f64 {
        let value = element.split(&format!("{name}=\"")).nth(1).and_then(|rest| rest.split('"').next());
        value.and_then(|value| value.parse().ok()).expect("a number")
    }

    /// Slope and intercept of the least-squares line, and the largest distance from it.
    fn line(pairs: &[(f64, f64)]) -> (f64, f64) {
        let n = pairs.len() as f64;
        let (mx, my) =
            (pairs.iter().map(|p| p.0).sum::<f64>() / n, pairs.iter().map(|p| p.1).sum::<f64>() / n);
        let sxx: f64 = pairs.iter().map(|p| (p.0 - mx).powi(2)).sum();
        let slope = pairs.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum::<f64>() / sxx;
        let worst = pairs.iter().map(|p| (p.1 - my - slope * (p.0 - mx)).abs()).fold(0.0, f64::max);
        (slope, worst)
    }

    #[test]
    fn figures_read_back_show_the_values_of_the_table() {
        let study = study();
        for (problem, against) in [
            (Problem::First, Against::InverseGap),
            (Problem::Second, Against::Acceleration),
            (Problem::First, Against::Bumper),
        ] {
            for (figure, excursion) in ratios(&study, Origin::Published, problem, against)
                .iter()
                .zip([problem == Problem::First, problem == Problem::Second])
            {
                // Circles stand for free flight and the first gap, in the order of the points.
                let plotted: Vec<Point> = points(&study, Origin::Published, problem, against, excursion)
                    .into_iter()
                    .filter(|p| gap_marker(p.gap) == Marker::Circle)
                    .collect();
                let svg = figure.chart.svg().expect("drawn");
                let circles: Vec<(f64, f64)> =
                    svg.split("<circle ").skip(1).map(|e| (attribute(e, "cx"), attribute(e, "cy"))).collect();
                // The legend is drawn first.
                let drawn = &circles[circles.len() - plotted.len()..];
                let vertical: Vec<(f64, f64)> = plotted.iter().zip(drawn).map(|(p, c)| (p.y, c.1)).collect();
                let (slope, worst) = line(&vertical);
                // Eight units of the drawing are one pixel.
                assert!(slope < 0.0 && worst < 2.0, "{}: {slope} {worst}", figure.name);
                if against != Against::InverseGap {
                    let horizontal: Vec<(f64, f64)> =
                        plotted.iter().zip(drawn).map(|(p, c)| (p.x, c.0)).collect();
                    let (slope, worst) = line(&horizontal);
                    assert!(slope > 0.0 && worst < 2.0, "{}: {slope} {worst}", figure.name);
                }
            }
        }
    }

    #[test]
    fn a_line_holds_what_belongs_together() {
        let point = |bumper, gap, level, x| Point { bumper, gap, level, x, y: 1.0 };
        let points = [
            point(1, Some(1), 0, 0.05),
            point(1, Some(0), 0, 0.067),
            point(2, Some(0), 0, 0.067),
            point(1, Some(0), 1, 0.067),
        ];
        let found = lines(&points, Against::InverseGap);
        assert_eq!(found.len(), 1, "one bumper at one level over two gaps");
        assert!(found[0][0].x < found[0][1].x);
        assert_eq!(number(Problem::First, Against::Bumper), 3);
        assert_eq!(number(Problem::Second, Against::Acceleration), 8);
    }
}
