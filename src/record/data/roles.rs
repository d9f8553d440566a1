//! Which column is what, in which unit and sign, and how columns become a [`Record`].

use super::inertia::drives_a_mass;
use super::{Columns, DataError, Kind, ReadOptions, Record, content, steps, uniform};
use std::path::Path;
use std::str::FromStr;

/// What a column can be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Role {
    /// Time, s.
    Time,
    /// Table displacement, m.
    TableDisplacement,
    /// Table acceleration, m/s2.
    TableAcceleration,
    /// First accelerometer on the mass, m/s2.
    MassAcceleration1,
    /// Second accelerometer on the mass, m/s2.
    MassAcceleration2,
    /// Displacement of the mass relative to the table, m.
    RelativeDisplacement,
    /// Force, N.
    Force,
    /// Displacement, m.
    Displacement,
    /// Acceleration, m/s2.
    Acceleration,
    /// Index of the sweep step, -1 between steps.
    Step,
}

impl Role {
    /// All roles, in the order of the columns.
    pub const ALL: [Self; 10] = [
        Self::Time,
        Self::TableDisplacement,
        Self::TableAcceleration,
        Self::MassAcceleration1,
        Self::MassAcceleration2,
        Self::RelativeDisplacement,
        Self::Force,
        Self::Displacement,
        Self::Acceleration,
        Self::Step,
    ];

    /// Column name, unit included.
    pub fn name(self) -> &'static str {
        match self {
            Self::Time => "time_s",
            Self::TableDisplacement => "table_displacement_m",
            Self::TableAcceleration => "table_acceleration_m_s2",
            Self::MassAcceleration1 => "mass_acceleration_1_m_s2",
            Self::MassAcceleration2 => "mass_acceleration_2_m_s2",
            Self::RelativeDisplacement => "relative_displacement_m",
            Self::Force => "force_n",
            Self::Displacement => "displacement_m",
            Self::Acceleration => "acceleration_m_s2",
            Self::Step => "step",
        }
    }

    /// Unit of the stored numbers.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Time => "s",
            Self::TableDisplacement | Self::RelativeDisplacement | Self::Displacement => "m",
            Self::TableAcceleration
            | Self::MassAcceleration1
            | Self::MassAcceleration2
            | Self::Acceleration => "m/s2",
            Self::Force => "N",
            Self::Step => "1",
        }
    }

    /// Factor from a unit to SI; `None` when it is none of the role's.
    pub(super) fn factor(self, unit: &str) -> Option<f64> {
        let known: &[(&str, f64)] = match self.unit() {
            "s" => &[("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9), ("min", 60.0), ("h", 3600.0)],
            "m" => &[
                ("m", 1.0),
                ("dm", 0.1),
                ("cm", 1e-2),
                ("mm", 1e-3),
                ("um", 1e-6),
                ("nm", 1e-9),
                ("in", 0.0254),
                ("ft", 0.3048),
            ],
            "m/s2" => &[
                ("m/s2", 1.0),
                ("m_s2", 1.0),
                ("cm/s2", 1e-2),
                ("gal", 1e-2),
                ("mm/s2", 1e-3),
                ("in/s2", 0.0254),
                ("ft/s2", 0.3048),
                ("g", crate::units::STANDARD_GRAVITY_M_S2),
                ("mg", 1e-3 * crate::units::STANDARD_GRAVITY_M_S2),
            ],
            "N" => &[
                ("n", 1.0),
                ("mn", 1e-3),
                ("un", 1e-6),
                ("kn", 1e3),
                ("lbf", 4.448_221_615_260_5),
                ("lb", 4.448_221_615_260_5),
                ("kip", 4_448.221_615_260_5),
                ("kgf", crate::units::STANDARD_GRAVITY_M_S2),
            ],
            _ => &[("1", 1.0)],
        };
        let unit = unit.to_ascii_lowercase();
        known.iter().find(|(name, _)| *name == unit).map(|(_, factor)| *factor)
    }
}

impl FromStr for Role {
    type Err = String;

    /// The column name, with or without its unit.
    fn from_str(text: &str) -> Result<Self, String> {
        let plain = |role: &Self| role.name().trim_end_matches("_m_s2").trim_end_matches("_m").to_owned();
        let short = |role: &Self| match role {
            Self::Time => "time".to_owned(),
            Self::Force => "force".to_owned(),
            role => plain(role),
        };
        let text = text.trim().to_ascii_lowercase();
        Self::ALL.into_iter().find(|role| text == role.name() || text == short(role)).ok_or_else(|| {
            let names: Vec<_> = Self::ALL.iter().map(|role| role.name()).collect();
            format!("no role `{text}`; roles are {}", names.join(", "))
        })
    }
}

/// One column for one role: `role=column`, `role=-column` (sign turned), `role=column:unit`.
#[derive(Clone, Debug, PartialEq)]
pub struct Mapping {
    /// What the column is.
    pub role: Role,
    /// Its name in the file.
    pub column: String,
    /// What its numbers are multiplied with to be SI, sign included.
    pub factor: f64,
    /// Whether the unit was stated with it; the file's own word holds otherwise.
    pub unit_known: bool,
}

impl Mapping {
    /// A column as it stands.
    pub fn new(role: Role, column: impl Into<String>) -> Self {
        Self { role, column: column.into(), factor: 1.0, unit_known: false }
    }
}

impl FromStr for Mapping {
    type Err = DataError;

    fn from_str(text: &str) -> Result<Self, DataError> {
        let wrong = |reason: String| DataError::Mapping { text: text.to_owned(), reason };
        let (role, rest) = text
            .split_once('=')
            .ok_or_else(|| wrong("expected `role=column` or `role=column:unit`".into()))?;
        let role: Role = role.parse().map_err(wrong)?;
        let (sign, rest) = match rest.strip_prefix('-') {
            Some(rest) => (-1.0, rest),
            None => (1.0, rest),
        };
        // A column name may hold a colon; only a known unit behind the last one is a unit.
        let (column, unit) = match rest.rsplit_once(':') {
            Some((column, unit)) => (
                column,
                Some(role.factor(unit).ok_or_else(|| {
                    wrong(format!("`{unit}` is no unit of {} ({})", role.name(), role.unit()))
                })?),
            ),
            None => (rest, None),
        };
        if column.is_empty() {
            return Err(wrong("the column has no name".into()));
        }
        let (factor, unit_known) = (sign * unit.unwrap_or(1.0), unit.is_some());
        Ok(Self { role, column: column.to_owned(), factor, unit_known })
    }
}

/// Picks the channels out of the columns, converts them, makes time uniform, finds the steps.
pub(super) fn assemble(
    path: &Path,
    mut columns: Columns,
    options: &ReadOptions,
) -> Result<Record, DataError> {
    let mut record = Record::empty(path.display().to_string(), Kind::Base, 0.0);
    record.notes = std::mem::take(&mut columns.notes);
    let mut step = None;
    for role in Role::ALL {
        let mapping = options.map.iter().find(|mapping| mapping.role == role);
        let name = mapping.map_or(role.name(), |mapping| mapping.column.as_str());
        let found = columns
            .names
            .iter()
            .position(|column| column.trim() == name)
            .or_else(|| columns.names.iter().position(|column| column.trim().eq_ignore_ascii_case(name)));
        let Some(found) = found else {
            if mapping.is_some() {
                let there = columns.names.join(", ");
                return Err(content(path, format!("no column `{name}`; there are: {there}")));
            }
            continue;
        };
        // A column may play two roles by mapping, so it is copied, not taken, only then.
        let shared = options.map.iter().filter(|mapping| mapping.column == name).count() > 1;
        let mut values =
            if shared { columns.values[found].clone() } else { std::mem::take(&mut columns.values[found]) };
        let mut factor = mapping.map_or(1.0, |mapping| mapping.factor);
        if !mapping.is_some_and(|mapping| mapping.unit_known)
            && let Some(unit) = &columns.units[found]
        {
            factor *= stated_unit(role, unit, &mut record.notes);
        }
        if factor != 1.0 {
            values.iter_mut().for_each(|value| *value *= factor);
        }
        match record.channel_mut(role) {
            Some(channel) => *channel = values,
            None => step = Some(values),
        }
    }
    record.kind = kind(path, &mut record, options.kind, &columns)?;
    keep_only(&mut record);
    complete(path, &record)?;
    let rate_hz = options.sample_rate_hz.or(columns.sample_rate_hz);
    uniform::make_uniform(path, &mut record, step, rate_hz)?;
    if record.step.is_empty() {
        steps::find(&mut record);
    }
    Ok(record)
}

/// Factor from the unit that the file itself states; what it leads to is noted.
fn stated_unit(role: Role, unit: &str, notes: &mut Vec<String>) -> f64 {
    let (name, si) = (role.name(), role.unit());
    match role.factor(unit) {
        Some(1.0) => 1.0,
        Some(factor) => {
            notes.push(format!("{name} is in {unit} in the file and was converted to {si}"));
            factor
        }
        None => {
            notes.push(format!(
                "the file says that {name} is in `{unit}`, which is no unit of it; {si} was taken"
            ));
            1.0
        }
    }
}

/// The kind asked for, stated, or the one that the channels speak for.
fn kind(path: &Path, record: &mut Record, asked: Option<Kind>, columns: &Columns) -> Result<Kind, DataError> {
    if let Some(kind) = asked.or(columns.kind) {
        return Ok(kind);
    }
    let force = !record.force_n.is_empty();
    if !record.table_acceleration_m_s2.is_empty() {
        Ok(Kind::Base)
    } else if force && !record.acceleration_m_s2.is_empty() {
        Ok(Kind::Force)
    } else if force && !record.displacement_m.is_empty() {
        let (kind, said) = if drives_a_mass(&record.displacement_m, &record.force_n) {
            let said = "displacement and force alone were taken as a force record (part of the force goes with the acceleration, as \
                        that of a mass does); `--kind component` if the displacement was imposed";
            (Kind::Force, said)
        } else {
            let said = "displacement and force alone were taken as a component record (displacement imposed); \
                        `--kind force` if the force was applied";
            (Kind::Component, said)
        };
        record.notes.push(said.to_owned());
        Ok(kind)
    } else {
        let there = columns.names.join(", ");
        let needed = if force {
            "a force or component record needs displacement_m or acceleration_m_s2 beside force_n"
        } else {
            "a base record needs table_acceleration_m_s2, a force or component record force_n"
        };
        Err(content(path, format!("{needed}; columns are: {there} (`--map role=column` names others)")))
    }
}

/// Empties channels that the kind has no use for.
fn keep_only(record: &mut Record) {
    let kept: &[Role] = match record.kind {
        Kind::Base => &[
            Role::TableDisplacement,
            Role::TableAcceleration,
            Role::MassAcceleration1,
            Role::MassAcceleration2,
            Role::RelativeDisplacement,
        ],
        Kind::Force => &[Role::Force, Role::Displacement, Role::Acceleration],
        Kind::Component => &[Role::Force, Role::Displacement],
    };
    for role in Role::ALL.into_iter().filter(|role| *role != Role::Time && !kept.contains(role)) {
        if let Some(channel) = record.channel_mut(role) {
            channel.clear();
        }
    }
}

/// What the kind cannot do without.
fn complete(path: &Path, record: &Record) -> Result<(), DataError> {
    let has = |role: Role| !record.channel(role).is_empty();
    let (needed, there) = match record.kind {
        Kind::Base => (
            "table_acceleration_m_s2 and one of mass_acceleration_1_m_s2, relative_displacement_m",
            has(Role::TableAcceleration) && (has(Role::MassAcceleration1) || has(Role::RelativeDisplacement)),
        ),
        Kind::Force => (
            "force_n and one of displacement_m, acceleration_m_s2",
            has(Role::Force) && (has(Role::Displacement) || has(Role::Acceleration)),
        ),
        Kind::Component => ("displacement_m and force_n", has(Role::Displacement) && has(Role::Force)),
    };
    if !there {
        let kind = format!("{:?}", record.kind).to_lowercase();
        return Err(content(
            path,
            format!("a {kind} record needs {needed} (`--map role=column` names others)"),
        ));
    }
    let lengths: Vec<(Role, usize)> = record.channels().map(|(role, values)| (role, values.len())).collect();
    let length = lengths[0].1;
    match lengths.iter().find(|(_, other)| *other != length) {
        Some((role, other)) => {
            let first = lengths[0].0.name();
            let reason = format!("{first} has {length} samples, {} has {other}", role.name());
            Err(content(path, reason))
        }
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mappings_know_units_and_signs() {
        let mapping: Mapping = "relative_displacement_m=-laser:mm".parse().expect("valid");
        assert_eq!(mapping.role, Role::RelativeDisplacement);
        assert_eq!((mapping.column.as_str(), mapping.factor), ("laser", -1e-3));
        let mapping: Mapping = "mass_acceleration_1=acc 1:g".parse().expect("valid");
        assert_eq!((mapping.role, mapping.factor), (Role::MassAcceleration1, 9.806_65));
        assert_eq!("force=F".parse::<Mapping>().expect("valid").factor, 1.0);
        for wrong in ["laser", "relative_displacement_m=laser:kg", "speed=x", "force_n=", "force_n=:kN"] {
            assert!(wrong.parse::<Mapping>().is_err(), "{wrong}");
        }
        for role in Role::ALL {
            assert_eq!(role.name().parse::<Role>(), Ok(role));
        }
    }
}
