//! One instant of the rig, and one command to it.

/// All channels of one DAQ instant, raw (unfiltered), SI.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Channels {
    /// Displacement of the table, m.
    pub table_displacement_m: f64,
    /// Acceleration of the table, m/s2.
    pub table_acceleration_m_s2: f64,
    /// Absolute acceleration at one edge of the mass, m/s2.
    pub mass_acceleration_1_m_s2: f64,
    /// Absolute acceleration at the opposite edge of the mass, m/s2.
    pub mass_acceleration_2_m_s2: f64,
    /// Displacement of the mass relative to the table, m (laser).
    pub relative_displacement_m: f64,
}

impl Channels {
    /// Mean of the two accelerometers on the mass: the absolute acceleration A, m/s2.
    pub fn mass_acceleration_m_s2(&self) -> f64 {
        0.5 * (self.mass_acceleration_1_m_s2 + self.mass_acceleration_2_m_s2)
    }
}

/// Status bits that the DAQ or the drive sends with a sample; zero means healthy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StatusBits(pub u32);

impl StatusBits {
    /// The drive is enabled and follows commands.
    pub const DRIVE_ENABLED: u32 = 1 << 0;
    /// The drive has tripped on its own.
    pub const DRIVE_FAULT: u32 = 1 << 1;
    /// The DAQ reports an input out of range.
    pub const OVERRANGE: u32 = 1 << 2;
    /// A link (serial or bus) is down.
    pub const LINK_DOWN: u32 = 1 << 3;

    /// Whether any of the given bits is set.
    pub fn has(self, bits: u32) -> bool {
        self.0 & bits != 0
    }
}

/// One sample as the DAQ delivered it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// The device's own sequence number, unwrapped to 64 bits; advances even when a sample is lost.
    pub sequence: u64,
    /// The device's time of this instant, us since its start.
    pub device_time_us: u64,
    /// Raw channels.
    pub channels: Channels,
    /// Device status.
    pub status: StatusBits,
}

/// What the table is asked to do at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command {
    /// Table displacement, m.
    pub displacement_m: f64,
    /// Table velocity, m/s (feed-forward).
    pub velocity_m_s: f64,
    /// Table acceleration, m/s2 (feed-forward).
    pub acceleration_m_s2: f64,
}

impl Command {
    /// What a drive makes of a command by itself `time_s` after it: it goes on with the command's acceleration.
    #[inline]
    pub fn after(&self, time_s: f64) -> Self {
        Self {
            displacement_m: self.displacement_m
                + time_s * (self.velocity_m_s + 0.5 * time_s * self.acceleration_m_s2),
            velocity_m_s: self.velocity_m_s + time_s * self.acceleration_m_s2,
            acceleration_m_s2: self.acceleration_m_s2,
        }
    }
}

impl std::ops::Add for Command {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            displacement_m: self.displacement_m + other.displacement_m,
            velocity_m_s: self.velocity_m_s + other.velocity_m_s,
            acceleration_m_s2: self.acceleration_m_s2 + other.acceleration_m_s2,
        }
    }
}

impl std::ops::Sub for Command {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self {
            displacement_m: self.displacement_m - other.displacement_m,
            velocity_m_s: self.velocity_m_s - other.velocity_m_s,
            acceleration_m_s2: self.acceleration_m_s2 - other.acceleration_m_s2,
        }
    }
}

/// One row of a run: what was measured, what was asked, what the onboard model said.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Row {
    /// The sample as delivered.
    pub sample: Sample,
    /// The command in force when the sample was taken.
    pub command: Command,
    /// Index of the sweep step within its counted cycles, -1 elsewhere.
    pub step: i32,
    /// Relative displacement of the onboard model, m.
    pub model_displacement_m: f64,
    /// Absolute mass acceleration of the onboard model, m/s2.
    pub model_acceleration_m_s2: f64,
    /// Active branch, contacts and friction state of the onboard model.
    pub model_regime: crate::model::Regime,
    /// State of the supervisor, its public number.
    pub supervisor_state: u8,
    /// Rows dropped just before this one because the ring was full.
    pub lost_before: u32,
}
