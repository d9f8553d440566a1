//! The objects of the dictionary that the master and the emulator use, by name.

/// Index and sub-index of an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Address {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
}

impl core::fmt::Display for Address {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{:#06x}:{:02x}", self.index, self.sub)
    }
}

/// An address.
pub const fn at(index: u16, sub: u8) -> Address {
    Address { index, sub }
}

/// Device type: profile number in the low word (402 for drives).
pub const DEVICE_TYPE: Address = at(0x1000, 0);
/// Error register.
pub const ERROR_REGISTER: Address = at(0x1001, 0);
/// Communication cycle period, us.
pub const COMMUNICATION_CYCLE_US: Address = at(0x1006, 0);
/// Name of the device, text.
pub const DEVICE_NAME: Address = at(0x1008, 0);
/// First entry of the heartbeat consumer list: node in bits 16-23, time in ms below.
pub const HEARTBEAT_CONSUMER: Address = at(0x1016, 1);
/// Heartbeat producer time, ms.
pub const HEARTBEAT_PRODUCER_MS: Address = at(0x1017, 0);
/// Vendor number of the identity.
pub const VENDOR: Address = at(0x1018, 1);
/// Product code of the identity.
pub const PRODUCT: Address = at(0x1018, 2);
/// Revision number of the identity.
pub const REVISION: Address = at(0x1018, 3);
/// Serial number of the identity.
pub const SERIAL: Address = at(0x1018, 4);
/// Communication parameters of the first receive PDO; later ones follow.
pub const RPDO_COMMUNICATION: u16 = 0x1400;
/// Mapping of the first receive PDO.
pub const RPDO_MAPPING: u16 = 0x1600;
/// Communication parameters of the first transmit PDO.
pub const TPDO_COMMUNICATION: u16 = 0x1800;
/// Mapping of the first transmit PDO.
pub const TPDO_MAPPING: u16 = 0x1A00;
/// What the drive does when the connection is lost: 3 is quick stop (CiA 402-2).
pub const ABORT_CONNECTION_OPTION: Address = at(0x6007, 0);
/// Error code of the last fault.
pub const ERROR_CODE: Address = at(0x603F, 0);
/// Controlword.
pub const CONTROLWORD: Address = at(0x6040, 0);
/// Statusword.
pub const STATUSWORD: Address = at(0x6041, 0);
/// What quick stop does: 6 is the quick stop ramp, then stay in quick stop active.
pub const QUICK_STOP_OPTION: Address = at(0x605A, 0);
/// Mode of operation asked for: 8 is cyclic synchronous position, 7 interpolated position.
pub const MODE: Address = at(0x6060, 0);
/// Mode of operation in force.
pub const MODE_DISPLAY: Address = at(0x6061, 0);
/// Actual position, counts.
pub const POSITION: Address = at(0x6064, 0);
/// Following error window, counts: beyond it for longer than the time-out the drive trips.
pub const FOLLOWING_ERROR_WINDOW: Address = at(0x6065, 0);
/// Following error time-out, ms.
pub const FOLLOWING_ERROR_TIME_MS: Address = at(0x6066, 0);
/// Actual velocity.
pub const VELOCITY: Address = at(0x606C, 0);
/// Target position, counts.
pub const TARGET_POSITION: Address = at(0x607A, 0);
/// Quick stop deceleration.
pub const QUICK_STOP_DECELERATION: Address = at(0x6085, 0);
/// Velocity offset (feed-forward).
pub const VELOCITY_OFFSET: Address = at(0x60B1, 0);
/// Torque offset (feed-forward), per mille of the rated torque.
pub const TORQUE_OFFSET: Address = at(0x60B2, 0);
/// Interpolation time period: mantissa; the exponent (base 10, seconds) is sub-index 2.
pub const INTERPOLATION_PERIOD: Address = at(0x60C2, 1);
/// Exponent of the interpolation time period.
pub const INTERPOLATION_EXPONENT: Address = at(0x60C2, 2);
/// Actual following error, counts.
pub const FOLLOWING_ERROR: Address = at(0x60F4, 0);
