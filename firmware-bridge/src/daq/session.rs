//! What host and device say to each other before samples flow.

use super::link::Started;
use super::{DaqError, DaqStream, LowLatency, open_port};
use crate::clock::HostClock;
use crate::wire::{
    AckCode, Acknowledge, CHANNELS, Calibration, Configure, Deframer, Identity, Kind, Message,
    PROTOCOL_VERSION, Unit, WIRE_MAX, encode,
};
use serialport::{SerialPort, TTYPort};
use std::boxed::Box;
use std::format;
use std::io::{Read, Write};
use std::string::{String, ToString};
use std::time::{Duration, Instant};
use std::vec::Vec;

/// Who must be on the line; `None` accepts any.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ExpectedDevice {
    /// Vendor number.
    pub vendor: Option<u32>,
    /// Product number.
    pub product: Option<u32>,
    /// Serial number.
    pub serial: Option<String>,
}

/// Settings of the DAQ link.
#[derive(Clone, Debug)]
pub struct DaqSettings {
    /// Path of the serial port.
    pub path: String,
    /// Baud rate, 1/s.
    pub baud: u32,
    /// Sampling rate, Hz.
    pub rate_hz: f64,
    /// Identity that is asked for.
    pub expected: ExpectedDevice,
    /// Silence after which the line counts as broken; above the 16 ms that an adapter may hold data back.
    pub silence: Duration,
}

const ANSWER_TIMEOUT: Duration = Duration::from_millis(250);
const ATTEMPTS: u32 = 4;

/// A device that is identified, calibrated and configured, and not yet sampling.
pub struct DaqDevice {
    port: TTYPort,
    deframer: Deframer,
    settings: DaqSettings,
    /// Who it is.
    pub identity: Identity,
    /// Its calibration, by channel.
    pub calibration: [Calibration; CHANNELS],
    /// Whether the line holds data back.
    pub low_latency: LowLatency,
    /// Rate in force, Hz.
    pub rate_hz: f64,
}

impl DaqDevice {
    /// Opens the port, identifies the device, reads its calibration and sets the rate. A stream that still
    /// runs from a host that died is stopped first.
    ///
    /// # Errors
    /// [`DaqError`]: no port, no answer, wrong device, refused rate.
    pub fn open(settings: DaqSettings) -> Result<Self, DaqError> {
        let (port, low_latency) = open_port(&settings.path, settings.baud, Duration::from_millis(20))?;
        let mut line = Line { port, deframer: Deframer::new(), path: &settings.path };
        line.request(&Message::Stop, "stop", |answer| acknowledged(answer, Kind::Stop))?;
        let identity = line.request(&Message::Identify, "identify", |answer| match answer {
            Message::Identity(identity) => Some(identity),
            _ => None,
        })?;
        check_identity(&settings, &identity)?;
        let mut calibration = [None; CHANNELS];
        for (channel, slot) in calibration.iter_mut().enumerate() {
            *slot = Some(line.calibration(channel as u8)?);
        }
        let rate_mhz = (settings.rate_hz * 1e3).round() as u32;
        let configure = Message::Configure(Configure { rate_mhz, bandwidth_mhz: 0 });
        let answer = line.request(&configure, "configure", |answer| acknowledged(answer, Kind::Configure))?;
        accepted("configure", answer)?;
        let Line { port, deframer, .. } = line;
        Ok(Self {
            port,
            deframer,
            identity,
            // Every channel was read above, or `open` has returned.
            calibration: calibration.map(|read| read.expect("every channel was read")),
            low_latency,
            rate_hz: f64::from(answer.value) / 1e3,
            settings,
        })
    }

    /// Starts sampling; from now on the port belongs to a thread. `on_thread` runs first on it (for its
    /// scheduling), `clock` stamps the arrivals.
    ///
    /// # Errors
    /// [`DaqError`]: no answer, refused, no thread.
    pub fn start(
        self,
        clock: HostClock,
        on_thread: Option<Box<dyn FnOnce() + Send>>,
    ) -> Result<DaqStream, DaqError> {
        let Self { port, deframer, settings, calibration, rate_hz, .. } = self;
        let mut line = Line { port, deframer, path: &settings.path };
        // Any number will do; the clock makes it differ from the one before.
        let token = clock.now_ns() as u32;
        let start = Message::Start { token };
        let mut early = Vec::new();
        let answer = line.ask_once(&start, "start", ANSWER_TIMEOUT, |message| {
            if let Message::Sample(frame) = message {
                early.push(frame);
            }
            acknowledged(message, Kind::Start)
        })?;
        accepted("start", answer)?;
        let Line { port, deframer, .. } = line;
        let silence = settings.silence;
        let started = Started { port, deframer, early, calibration, rate_hz, silence };
        DaqStream::spawn(started, clock, on_thread)
    }
}

fn acknowledged(answer: Message, request: Kind) -> Option<Acknowledge> {
    match answer {
        Message::Acknowledge(ack) if ack.request == request as u8 => Some(ack),
        _ => None,
    }
}

fn accepted(request: &'static str, answer: Acknowledge) -> Result<(), DaqError> {
    match answer.code {
        AckCode::Done => Ok(()),
        code => Err(DaqError::Refused { request, code, value: answer.value }),
    }
}

fn check_identity(settings: &DaqSettings, identity: &Identity) -> Result<(), DaqError> {
    let wrong = |what, expected: String, received: String| {
        Err(DaqError::WrongDevice { path: settings.path.clone(), what, expected, received })
    };
    if identity.protocol != PROTOCOL_VERSION {
        return wrong("protocol", PROTOCOL_VERSION.to_string(), identity.protocol.to_string());
    }
    if usize::from(identity.channels) != CHANNELS {
        return wrong("number of channels", CHANNELS.to_string(), identity.channels.to_string());
    }
    let numbers = [
        ("vendor", settings.expected.vendor, identity.vendor),
        ("product", settings.expected.product, identity.product),
    ];
    for (what, expected, received) in numbers {
        if let Some(expected) = expected
            && expected != received
        {
            return wrong(what, format!("{expected:#010x}"), format!("{received:#010x}"));
        }
    }
    let serial = text_of(&identity.serial);
    match &settings.expected.serial {
        Some(expected) if *expected != serial => wrong("serial number", expected.clone(), serial),
        _ => Ok(()),
    }
}

/// A zero-padded field as text.
pub(crate) fn text_of(bytes: &[u8; 16]) -> String {
    let used = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..used]).into_owned()
}

struct Line<'a> {
    port: TTYPort,
    deframer: Deframer,
    path: &'a str,
}

impl Line<'_> {
    /// Asks, and asks again when a frame was spoilt: every request but start may be repeated.
    fn request<T>(
        &mut self,
        message: &Message,
        name: &'static str,
        mut pick: impl FnMut(Message) -> Option<T>,
    ) -> Result<T, DaqError> {
        for _ in 1..ATTEMPTS {
            match self.ask_once(message, name, ANSWER_TIMEOUT, &mut pick) {
                Err(DaqError::NoAnswer { .. }) => {}
                other => return other,
            }
        }
        self.ask_once(message, name, ANSWER_TIMEOUT, &mut pick)
    }

    fn ask_once<T>(
        &mut self,
        message: &Message,
        name: &'static str,
        timeout: Duration,
        mut pick: impl FnMut(Message) -> Option<T>,
    ) -> Result<T, DaqError> {
        let failed = |path: &str, source| DaqError::Line { path: path.into(), source };
        let mut wire = [0; WIRE_MAX];
        let used = encode(message, &mut wire);
        // A zero first ends whatever garbage the device may have collected.
        self.port.write_all(&[0]).map_err(|e| failed(self.path, e))?;
        self.port.write_all(&wire[..used]).map_err(|e| failed(self.path, e))?;
        let deadline = Instant::now() + timeout;
        let mut buffer = [0; 1024];
        // What has come is read even when this thread gets the processor only after the time: the device did answer.
        while Instant::now() < deadline
            || self.port.bytes_to_read().map_err(|e| failed(self.path, e.into()))? > 0
        {
            let count = match self.port.read(&mut buffer) {
                Ok(count) => count,
                Err(error) if error.kind() == std::io::ErrorKind::TimedOut => continue,
                Err(error) => return Err(failed(self.path, error)),
            };
            let mut answer = None;
            self.deframer.feed(&buffer[..count], |found| {
                if let Ok(message) = found {
                    // Every message is shown, also behind the answer.
                    let picked = pick(message);
                    answer = answer.take().or(picked);
                }
            });
            if let Some(answer) = answer {
                return Ok(answer);
            }
        }
        let timeout_ms = timeout.as_millis() as u64;
        Err(DaqError::NoAnswer { path: self.path.into(), request: name, timeout_ms })
    }

    fn calibration(&mut self, channel: u8) -> Result<Calibration, DaqError> {
        let request = Message::ReadCalibration { channel };
        let calibration = self.request(&request, "read calibration", |answer| match answer {
            Message::Calibration(calibration) if calibration.channel == channel => Some(calibration),
            _ => None,
        })?;
        let expected = if matches!(channel, 0 | 4) { Unit::Metre } else { Unit::MetrePerSecondSquared };
        if calibration.unit != expected {
            return Err(DaqError::WrongDevice {
                path: self.path.into(),
                what: "unit of a channel",
                expected: format!("{expected:?} on channel {channel}"),
                received: format!("{:?}", calibration.unit),
            });
        }
        Ok(calibration)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_that_waits_is_taken_though_its_time_is_over() {
        let (mut device, host) = TTYPort::pair().expect("a pseudo terminal");
        let path = host.name().expect("a path");
        let (port, _) = open_port(&path, 921_600, Duration::from_millis(20)).expect("a port");
        let mut line = Line { port, deframer: Deframer::new(), path: &path };
        let done = Acknowledge { request: Kind::Stop as u8, code: AckCode::Done, value: 0 };
        let mut wire = [0; WIRE_MAX];
        let used = encode(&Message::Acknowledge(done), &mut wire);
        device.write_all(&wire[..used]).expect("sent");
        while line.port.bytes_to_read().expect("a number") < used as u32 {
            std::thread::yield_now();
        }
        let ask = |line: &mut Line| {
            line.ask_once(&Message::Stop, "stop", Duration::ZERO, |answer| acknowledged(answer, Kind::Stop))
        };
        assert_eq!(ask(&mut line).expect("an answer").code, AckCode::Done);
        assert!(matches!(ask(&mut line), Err(DaqError::NoAnswer { request: "stop", timeout_ms: 0, .. })));
    }
}
