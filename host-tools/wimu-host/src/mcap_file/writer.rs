//! Writer of a recording in progress.

use std::collections::BTreeSet;

use mcap::records::{MessageHeader, Metadata};
use mcap::{McapError, WriteOptions, Writer};
use wimu_model::ParameterId;

use super::*;
use crate::calibration::source;
use crate::ros::message::{Message as Cdr, schema as ros_schema};

/// Writes ROS 2 messages in CDR to an MCAP file, in chunks without compression.
///
/// Dropping it closes the file as well; [`RosFile::finish`] also returns errors.
pub(crate) struct RosFile<W: Write + Seek> {
    name: String,
    pub(super) container: Writer<W>,
    /// Channel and number of messages of each topic.
    topics: BTreeMap<String, (u16, u32)>,
}

impl<W: Write + Seek> RosFile<W> {
    /// Begins a file in the empty `sink`, with this name in errors.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn new(sink: W, name: &str) -> Result<Self> {
        Self::by(concat!("wimu-ros ", env!("CARGO_PKG_VERSION")), sink, name)
    }

    /// The same, by `library`, which tells recordings from other files: [`library`].
    fn by(library: &str, sink: W, name: &str) -> Result<Self> {
        // A chunk is written when it is complete: what a cut-off file lacks is known.
        let options = WriteOptions::new().profile("ros2").library(library);
        let options = options.chunk_size(Some(CHUNK_BYTES)).disable_seeking(true);
        // Every chunk has a CRC of its own.
        let options = options.calculate_data_section_crc(false);
        Ok(Self {
            container: options.create(sink).map_err(|error| failed(name, error))?,
            name: name.to_owned(),
            topics: BTreeMap::new(),
        })
    }

    fn channel(&mut self, topic: &str, schema_name: &str, schema: &str) -> Result<u16> {
        let schema = (self.container).add_schema(schema_name, "ros2msg", schema.as_bytes());
        let none = BTreeMap::new();
        schema
            .and_then(|schema| self.container.add_channel(schema, topic, "cdr", &none))
            .map_err(|error| failed(&self.name, error))
    }

    fn write(&mut self, header: &MessageHeader, data: &[u8]) -> Result<()> {
        let written = self.container.write_to_known_channel(header, data);
        written.map_err(|error| failed(&self.name, error))
    }

    /// Appends a message of a type such as `sensor_msgs/Imu`, with log time and stamp, ns.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn publish(
        &mut self,
        topic: &str,
        type_name: &str,
        log_ns: u64,
        stamp_ns: u64,
        message: &Cdr,
    ) -> Result<()> {
        if !self.topics.contains_key(topic) {
            let schema_name = type_name.replacen('/', "/msg/", 1);
            let channel = self.channel(topic, &schema_name, &ros_schema(type_name))?;
            self.topics.insert(topic.to_owned(), (channel, 0));
        }
        let Some((channel, sequence)) = self.topics.get_mut(topic) else {
            return Ok(());
        };
        let header = MessageHeader {
            channel_id: *channel,
            sequence: *sequence,
            log_time: log_ns,
            publish_time: stamp_ns,
        };
        *sequence = sequence.wrapping_add(1);
        self.write(&header, message.bytes())
    }

    /// Messages by topic.
    pub fn counts(&self) -> BTreeMap<String, u64> {
        let count = |(topic, (_, count)): (&String, &(u16, u32))| (topic.clone(), (*count).into());
        self.topics.iter().map(count).collect()
    }

    /// Closes the file with its index.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn finish(mut self) -> Result<W> {
        let finished = self.container.finish();
        finished.map_err(|error| failed(&self.name, error))?;
        let mut sink = self.container.into_inner();
        let flushed = sink.flush();
        flushed.map_err(|error| Problem::file(&self.name, "write", &error))?;
        Ok(sink)
    }
}

fn failed(name: &str, error: McapError) -> Problem {
    let error = match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    };
    Problem::file(name, "write", &error)
}

/// Writes a recording in progress. Its index takes about 1 MB for each hour.
///
/// Dropping it closes the file as well; [`RecordingWriter::finish`] also returns errors.
pub struct RecordingWriter<W: Write + Seek> {
    pub(super) file: RosFile<W>,
    anchor: ClockAnchor,
    /// Channel and messages so far, in the order of [`TOPICS`].
    channels: [(u16, u32); TOPICS.len()],
    pub(super) last_flush_ns: Option<u64>,
    message: Vec<u8>,
    /// Calibrations in the file.
    kept: BTreeSet<u32>,
}

impl RecordingWriter<File> {
    /// Creates a file; an existing one is not changed.
    ///
    /// # Errors
    /// `file_exists`, `file_unreadable`, `file_failed`.
    pub fn create(path: &Path, anchor: ClockAnchor) -> Result<Self> {
        let name = path.display().to_string();
        let file = File::options()
            .read(true)
            .write(true)
            .create_new(true)
            .open(path)
            .map_err(|e| Problem::file(&name, "create", &e))?;
        Self::new(file, &name, anchor)
    }
}

impl<W: Write + Seek> RecordingWriter<W> {
    /// Begins a recording in the empty `sink`, with this name in errors.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn new(sink: W, name: &str, anchor: ClockAnchor) -> Result<Self> {
        let mut file = RosFile::by(concat!("wimu ", env!("CARGO_PKG_VERSION")), sink, name)?;
        let mut metadata = BTreeMap::from([
            ("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("anchor_monotonic_ns".to_owned(), anchor.monotonic_ns.to_string()),
            ("anchor_utc_ns".to_owned(), anchor.utc_ns.to_string()),
        ]);
        let mut channels = [(0, 0); TOPICS.len()];
        for (channel, topic) in channels.iter_mut().zip(TOPICS) {
            let (role, content) = topic;
            let (schema_name, schema) = match content {
                Content::Received | Content::Sent => (SCHEMA_NAME, SCHEMA),
                Content::State => (TEXT_SCHEMA_NAME, TEXT_SCHEMA),
            };
            let name = format!("/{role}/{}", content.name());
            channel.0 = file.channel(&name, schema_name, schema)?;
            // The channel records are in the first chunk only: the ids here make the rest readable if that is damaged.
            metadata.insert(channel_key(topic), channel.0.to_string());
        }
        let metadata = Metadata { name: METADATA.to_owned(), metadata };
        let begun =
            (file.container.write_metadata(&metadata)).and_then(|()| file.container.flush());
        begun.map_err(|error| failed(name, error))?;
        Ok(Self {
            file,
            anchor,
            channels,
            last_flush_ns: None,
            message: Vec::new(),
            kept: BTreeSet::new(),
        })
    }

    /// Keeps the source of the parameters that a board has, once, if it is known here.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn keep_calibration(&mut self, id: ParameterId) -> Result<()> {
        if self.kept.contains(&id.0) {
            return Ok(());
        }
        let Some(set) = source::find(id) else { return Ok(()) };
        self.kept.insert(id.0);
        let entry = (id.to_string(), source::to_text(&set));
        let metadata = Metadata { name: CALIBRATION.to_owned(), metadata: BTreeMap::from([entry]) };
        let written = self.file.container.write_metadata(&metadata);
        written.map_err(|error| failed(&self.file.name, error))
    }

    /// Appends bytes that the link of `role` received at `host_ns`, ns on the anchored monotonic clock.
    /// Flushes data that are a second old.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn append(&mut self, role: LinkRole, host_ns: u64, bytes: &[u8]) -> Result<()> {
        let mut message = std::mem::take(&mut self.message);
        encode(bytes, &mut message);
        let written = self.write(role, Content::Received, host_ns, &message);
        self.message = message;
        written
    }

    /// Appends an entry, as [`append`](Self::append) does.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn record(&mut self, entry: &Recorded) -> Result<()> {
        let mut message = Vec::new();
        match entry {
            Recorded::Received(received) => {
                self.append(received.role, received.host_ns, &received.bytes)
            }
            Recorded::Sent { role, host_ns, bytes } => {
                encode(bytes, &mut message);
                self.write(*role, Content::Sent, *host_ns, &message)
            }
            Recorded::Lost { role, host_ns, reason } => {
                encode_text(&format!("{LOST}{reason}"), &mut message);
                self.write(*role, Content::State, *host_ns, &message)
            }
            Recorded::Connected { role, host_ns } => {
                encode_text(CONNECTED, &mut message);
                self.write(*role, Content::State, *host_ns, &message)
            }
            Recorded::Damaged { role, host_ns } => {
                encode_text(DAMAGED, &mut message);
                self.write(*role, Content::State, *host_ns, &message)
            }
        }
    }

    fn write(
        &mut self,
        role: LinkRole,
        content: Content,
        host_ns: u64,
        message: &[u8],
    ) -> Result<()> {
        let wanted = |topic: &(LinkRole, Content)| *topic == (role, content);
        let index = TOPICS.iter().position(wanted).unwrap_or(0);
        let (channel, sequence) = self.channels[index];
        self.channels[index].1 = sequence.wrapping_add(1);
        let log_time = self.anchor.to_utc_ns(host_ns);
        let header =
            MessageHeader { channel_id: channel, sequence, log_time, publish_time: log_time };
        self.file.write(&header, message)?;
        self.tick(host_ns)
    }

    /// The file, for further topics.
    pub(crate) fn ros(&mut self) -> &mut RosFile<W> {
        &mut self.file
    }

    /// Host's monotonic clock to UTC.
    pub fn anchor(&self) -> ClockAnchor {
        self.anchor
    }

    /// Time of the latest flush, ns.
    pub(crate) fn flushed_ns(&self) -> Option<u64> {
        self.last_flush_ns
    }

    /// Flushes if a second has passed: to be called while nothing is received.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn tick(&mut self, host_ns: u64) -> Result<()> {
        let last = *self.last_flush_ns.get_or_insert(host_ns);
        if host_ns.saturating_sub(last) >= FLUSH_NS {
            self.last_flush_ns = Some(host_ns);
            self.flush()?;
        }
        Ok(())
    }

    /// Writes all buffered data to the file.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn flush(&mut self) -> Result<()> {
        let flushed = self.file.container.flush();
        flushed.map_err(|error| failed(&self.file.name, error))
    }

    /// Closes the recording with its index.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn finish(self) -> Result<W> {
        self.file.finish()
    }
}
