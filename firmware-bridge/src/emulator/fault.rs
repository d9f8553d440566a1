//! Faults that can be asked of the emulated devices, and their words on a command line.

use std::str::FromStr;
use std::string::String;
use std::vec::Vec;

/// Something that goes wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// So many bytes of noise on the serial line.
    DaqGarbage(u32),
    /// Bits flip with this probability from now on.
    DaqBitErrors(f64),
    /// The next samples are held back and come at once, so many.
    DaqHold(u32),
    /// The device samples on, but sends nothing.
    DaqSilent,
    /// The serial cable is out.
    DaqUnplug,
    /// Two channels change places.
    DaqSwap(u8, u8),
    /// A channel has the wrong gain (-1: sign, 0: dead).
    DaqGain(u8, f64),
    /// The drive neither hears nor speaks.
    DriveSilent,
    /// The drive trips with this error code.
    DriveTrip(u16),
    /// The drive loses its power for a moment.
    DriveRestart,
    /// The host's CAN controller goes off the bus.
    BusOff,
}

/// Words that are no fault.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "'{0}' is no fault; known are: daq garbage BYTES | daq bit-errors RATE | daq hold SAMPLES | daq silent | daq unplug \
     | daq swap A B | daq gain CHANNEL FACTOR | drive silent | drive trip CODE | drive restart | drive bus-off"
)]
pub struct FaultError(String);

impl FromStr for Fault {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        let words: Vec<&str> = text.split_whitespace().collect();
        parse(&words).ok_or_else(|| FaultError(text.into()))
    }
}

fn parse(words: &[&str]) -> Option<Fault> {
    let channel = |word: &str| word.parse().ok().filter(|c| usize::from(*c) < crate::wire::CHANNELS);
    Some(match *words {
        ["daq", "garbage", bytes] => Fault::DaqGarbage(bytes.parse().ok()?),
        ["daq", "bit-errors", rate] => {
            Fault::DaqBitErrors(rate.parse().ok().filter(|r| (0.0..=1.0).contains(r))?)
        }
        ["daq", "hold", samples] => Fault::DaqHold(samples.parse().ok()?),
        ["daq", "silent"] => Fault::DaqSilent,
        ["daq", "unplug"] => Fault::DaqUnplug,
        ["daq", "swap", a, b] => Fault::DaqSwap(channel(a)?, channel(b)?),
        ["daq", "gain", c, factor] => Fault::DaqGain(channel(c)?, factor.parse().ok()?),
        ["drive", "silent"] => Fault::DriveSilent,
        ["drive", "trip", code] => {
            let digits = code.strip_prefix("0x")?;
            Fault::DriveTrip(u16::from_str_radix(digits, 16).ok()?)
        }
        ["drive", "restart"] => Fault::DriveRestart,
        ["drive", "bus-off"] => Fault::BusOff,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_name_faults_and_mistakes_are_answered_with_the_list() {
        assert_eq!("daq swap 2 4".parse(), Ok(Fault::DaqSwap(2, 4)));
        assert_eq!("drive trip 0x8611".parse(), Ok(Fault::DriveTrip(0x8611)));
        for wrong in ["daq swap 2 5", "daq bit-errors 2", "drive trip 8611", "drive", ""] {
            assert!(wrong.parse::<Fault>().is_err(), "{wrong}");
        }
    }
}
