//! `samples.h5`: one chunked compound data set `samples`, a row a sample, appended in blocks. The only
//! file of the product that knows the HDF5 library. The file opens in any HDF5 reader at every moment,
//! after `kill -9` too, since each append is published as a whole.

use super::chain::{Link, RowChain};
use crate::model::Regime;
use crate::stream::{Channels, Command, Row, Sample, StatusBits};
use hdf5_pure::{
    AttrValue, CompoundTypeBuilder, Dataset, File, FileAccessProperties, FileBuilder, FileLocking, MaxExtent,
    SyncPolicy,
};
use std::path::{Path, PathBuf};

/// Name of the data set.
pub const DATASET: &str = "samples";
/// Bytes of one row.
pub const ROW_BYTES: usize = 112;

/// Rows of one chunk of the file, a quarter of a second of them. Writing whole chunks only keeps the file
/// compact: a chunk that grows is written anew elsewhere.
pub fn chunk_rows(sample_rate_hz: f64) -> usize {
    ((0.25 * sample_rate_hz) as usize).clamp(16, 8192)
}

/// Why a sample file could not be written or read.
#[derive(Debug, thiserror::Error)]
pub enum SampleFileError {
    /// The HDF5 library refused.
    #[error("{path}: {source}")]
    Hdf5 {
        /// Which file.
        path: PathBuf,
        /// What the library says.
        source: Box<hdf5_pure::Error>,
    },
    /// The library gave up on the file.
    #[error("{path}: damaged")]
    Damaged {
        /// Which file.
        path: PathBuf,
    },
    /// The file is not one of ours.
    #[error("{path}: rows of {found} bytes; a run of this version has {ROW_BYTES}")]
    Layout {
        /// Which file.
        path: PathBuf,
        /// Bytes of a row found.
        found: u64,
    },
}

fn wrap(path: &Path) -> impl Fn(hdf5_pure::Error) -> SampleFileError + '_ {
    move |source| SampleFileError::Hdf5 { path: path.to_owned(), source: Box::new(source) }
}

/// Flags of a row: bits 0-7 isolator branch, 8 right contact, 9 left contact, 10 sticking (onboard
/// model), bits 16-23 the supervisor's state.
fn flags(row: &Row) -> u32 {
    let regime = row.model_regime;
    u32::from(regime.isolator_branch)
        | u32::from(regime.right_contact) << 8
        | u32::from(regime.left_contact) << 9
        | u32::from(regime.sticking) << 10
        | u32::from(row.supervisor_state) << 16
}

/// Writes a row as it stands in the file: packed, little endian.
pub fn encode(row: &Row, sample_rate_hz: f64, out: &mut Vec<u8>) {
    let (sample, channels) = (&row.sample, &row.sample.channels);
    let floats = [
        channels.table_displacement_m,
        channels.table_acceleration_m_s2,
        channels.mass_acceleration_1_m_s2,
        channels.mass_acceleration_2_m_s2,
        channels.relative_displacement_m,
        row.command.displacement_m,
        row.command.velocity_m_s,
        row.command.acceleration_m_s2,
    ];
    out.extend_from_slice(&(sample.sequence as f64 / sample_rate_hz).to_le_bytes());
    out.extend_from_slice(&sample.sequence.to_le_bytes());
    out.extend_from_slice(&sample.device_time_us.to_le_bytes());
    for value in floats {
        out.extend_from_slice(&value.to_le_bytes());
    }
    out.extend_from_slice(&(row.model_displacement_m as f32).to_le_bytes());
    out.extend_from_slice(&(row.model_acceleration_m_s2 as f32).to_le_bytes());
    out.extend_from_slice(&row.step.to_le_bytes());
    out.extend_from_slice(&sample.status.0.to_le_bytes());
    out.extend_from_slice(&flags(row).to_le_bytes());
    out.extend_from_slice(&row.lost_before.to_le_bytes());
}

/// Eight, or four, bytes of a row from an offset.
fn bytes<const N: usize>(row: &[u8], at: usize) -> [u8; N] {
    let mut out = [0; N];
    out.copy_from_slice(&row[at..at + N]);
    out
}

/// Reads a row of [`ROW_BYTES`] bytes back.
pub fn decode(row: &[u8]) -> Row {
    let float = |at| f64::from_le_bytes(bytes(row, at));
    let single = |at| f64::from(f32::from_le_bytes(bytes(row, at)));
    let word = |at| u32::from_le_bytes(bytes(row, at));
    let flags = word(104);
    Row {
        sample: Sample {
            sequence: u64::from_le_bytes(bytes(row, 8)),
            device_time_us: u64::from_le_bytes(bytes(row, 16)),
            channels: Channels {
                table_displacement_m: float(24),
                table_acceleration_m_s2: float(32),
                mass_acceleration_1_m_s2: float(40),
                mass_acceleration_2_m_s2: float(48),
                relative_displacement_m: float(56),
            },
            status: StatusBits(word(100)),
        },
        command: Command { displacement_m: float(64), velocity_m_s: float(72), acceleration_m_s2: float(80) },
        model_displacement_m: single(88),
        model_acceleration_m_s2: single(92),
        step: i32::from_le_bytes(bytes(row, 96)),
        model_regime: Regime {
            isolator_branch: flags as u8,
            right_contact: flags >> 8 & 1 != 0,
            left_contact: flags >> 9 & 1 != 0,
            sticking: flags >> 10 & 1 != 0,
        },
        supervisor_state: (flags >> 16) as u8,
        lost_before: word(108),
    }
}

/// Bytes as lower-case hexadecimal.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Appends rows to a new file.
pub struct SampleWriter {
    path: PathBuf,
    sample_rate_hz: f64,
    file: File,
    dataset: Dataset,
    block: Vec<u8>,
    chain: RowChain,
    rows: u64,
}

impl SampleWriter {
    /// Creates the file with an empty data set.
    ///
    /// # Errors
    /// [`SampleFileError::Hdf5`] when the file cannot be made.
    pub fn create(path: &Path, sample_rate_hz: f64) -> Result<Self, SampleFileError> {
        let mut layout =
            CompoundTypeBuilder::new().f64_field("time_s").u64_field("sequence").u64_field("device_time_us");
        for name in [
            "table_displacement_m",
            "table_acceleration_m_s2",
            "mass_acceleration_1_m_s2",
            "mass_acceleration_2_m_s2",
            "relative_displacement_m",
            "command_displacement_m",
            "command_velocity_m_s",
            "command_acceleration_m_s2",
        ] {
            layout = layout.f64_field(name);
        }
        let layout = layout
            .f32_field("model_displacement_m")
            .f32_field("model_acceleration_m_s2")
            .i32_field("step")
            .u32_field("status")
            .u32_field("flags")
            .u32_field("lost_before")
            .build()
            .map_err(|error| wrap(path)(error.into()))?;
        let mut builder = FileBuilder::new();
        builder
            .create_dataset(DATASET)
            .with_compound_data(layout, Vec::new(), 0)
            .with_shape(&[0])
            .with_maxshape(&[MaxExtent::Unlimited])
            .with_chunks(&[chunk_rows(sample_rate_hz) as u64])
            .set_attr("sample_rate_hz", AttrValue::F64(sample_rate_hz));
        builder.write(path).map_err(wrap(path))?;
        // Writes reach the system at once, which is what survives a killed process; the recorder forces
        // them to the disk once a second, which bounds what a power cut costs.
        let properties = FileAccessProperties::new()
            .with_sync_policy(SyncPolicy::OnClose)
            // Other readers may open the file while it grows; that one process writes it is the folder's lock's to say.
            .with_locking(FileLocking::Disabled);
        let file = File::open_rw_with_options(path, properties).map_err(wrap(path))?;
        let dataset = file.dataset(DATASET).map_err(wrap(path))?;
        Ok(Self {
            path: path.to_owned(),
            sample_rate_hz,
            file,
            dataset,
            block: Vec::with_capacity(chunk_rows(sample_rate_hz) * ROW_BYTES),
            chain: RowChain::default(),
            rows: 0,
        })
    }

    /// Appends rows; `link` gets each new link of the hash chain.
    ///
    /// # Errors
    /// [`SampleFileError::Hdf5`]; the rows before stay readable.
    pub fn append(&mut self, rows: &[Row], link: impl FnMut(Link)) -> Result<(), SampleFileError> {
        self.block.clear();
        for row in rows {
            encode(row, self.sample_rate_hz, &mut self.block);
        }
        self.dataset.append_raw(&self.block).map_err(wrap(&self.path))?;
        self.chain.update(&self.block, link);
        self.rows += rows.len() as u64;
        Ok(())
    }

    /// Rows written.
    pub fn rows(&self) -> u64 {
        self.rows
    }

    /// Closes the file and returns the last link of the chain, which stands for all rows.
    ///
    /// # Errors
    /// [`SampleFileError::Hdf5`] when the last write fails.
    pub fn close(self) -> Result<Link, SampleFileError> {
        drop(self.dataset);
        self.file.close().map_err(wrap(&self.path))?;
        Ok(self.chain.last())
    }
}

/// Reads a sample file, finished or not.
pub struct SampleReader {
    path: PathBuf,
    dataset: Dataset,
    rows: u64,
    sample_rate_hz: f64,
}

impl SampleReader {
    /// Opens a file.
    ///
    /// # Errors
    /// [`SampleFileError`] when it is no HDF5 file or not one of ours.
    pub fn open(path: &Path) -> Result<Self, SampleFileError> {
        let file = File::open_streaming(path).map_err(wrap(path))?;
        let dataset = file.dataset(DATASET).map_err(wrap(path))?;
        let found = dataset.element_size().map_err(wrap(path))?;
        if found != ROW_BYTES as u64 {
            return Err(SampleFileError::Layout { path: path.to_owned(), found });
        }
        let rows = dataset.shape().map_err(wrap(path))?.first().copied().unwrap_or(0);
        let attributes = dataset.attrs().map_err(wrap(path))?;
        let sample_rate_hz = attributes
            .get("sample_rate_hz")
            .and_then(AttrValue::as_f64)
            .unwrap_or(crate::units::SAMPLE_RATE_HZ);
        Ok(Self { path: path.to_owned(), dataset, rows, sample_rate_hz })
    }

    /// Number of rows.
    pub fn rows(&self) -> u64 {
        self.rows
    }

    /// Sampling rate, Hz.
    pub fn sample_rate_hz(&self) -> f64 {
        self.sample_rate_hz
    }

    /// Bytes of `count` rows from row `start`.
    ///
    /// # Errors
    /// [`SampleFileError::Hdf5`] when the file is damaged there.
    pub fn read_bytes(&self, start: u64, count: u64) -> Result<Vec<u8>, SampleFileError> {
        self.dataset.read_raw_rows(start, count).map_err(wrap(&self.path))
    }

    /// Rows `start..start + count`.
    ///
    /// # Errors
    /// [`SampleFileError::Hdf5`] when the file is damaged there.
    pub fn read(&self, start: u64, count: u64) -> Result<Vec<Row>, SampleFileError> {
        Ok(self.read_bytes(start, count)?.chunks_exact(ROW_BYTES).map(decode).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(sequence: u64) -> Row {
        let x = sequence as f64;
        Row {
            sample: Sample {
                sequence,
                device_time_us: 488 * sequence,
                channels: Channels {
                    table_displacement_m: x,
                    table_acceleration_m_s2: -x,
                    mass_acceleration_1_m_s2: 0.1 * x,
                    mass_acceleration_2_m_s2: 0.2 * x,
                    relative_displacement_m: 0.3 * x,
                },
                status: StatusBits(StatusBits::DRIVE_ENABLED),
            },
            command: Command { displacement_m: 2.0 * x, velocity_m_s: 3.0, acceleration_m_s2: 4.0 },
            step: sequence as i32 - 5,
            model_displacement_m: 0.5,
            model_acceleration_m_s2: -0.25,
            model_regime: Regime {
                isolator_branch: 2,
                right_contact: true,
                left_contact: false,
                sticking: true,
            },
            supervisor_state: 3,
            lost_before: 9,
        }
    }

    #[test]
    fn rows_come_back_as_written_in_blocks_of_any_size() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("samples.h5");
        let mut writer = SampleWriter::create(&path, 2048.0).expect("created");
        let rows: Vec<Row> = (0..5000).map(row).collect();
        let mut links = Vec::new();
        for block in rows.chunks(777) {
            writer.append(block, |link| links.push(link)).expect("appended");
            let reader = SampleReader::open(&path).expect("opens while it is written");
            assert_eq!(reader.rows(), writer.rows());
        }
        let last = writer.close().expect("closed");
        let reader = SampleReader::open(&path).expect("opens");
        assert_eq!(reader.read(0, 5000).expect("reads"), rows);
        assert_eq!(reader.read(2040, 10).expect("reads"), rows[2040..2050]);
        let mut again = RowChain::default();
        let mut expected = Vec::new();
        again.update(&reader.read_bytes(0, 5000).expect("reads"), |link| expected.push(link));
        assert_eq!((again.last(), &expected), (last, &links));
        assert_eq!(links.iter().map(|link| link.rows).collect::<Vec<_>>(), [2048, 4096]);
    }
}
