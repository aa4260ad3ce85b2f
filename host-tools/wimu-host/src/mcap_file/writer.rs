//! Writing a recording while it happens.

use super::*;

/// A further topic of a [`RecordingWriter`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Topic(u16);

/// Writes a recording while it happens.
///
/// Dropping it closes the file as well; [`RecordingWriter::finish`] also tells whether that worked.
pub struct RecordingWriter<W: Write + Seek> {
    name: String,
    pub(super) writer: mcap::Writer<W>,
    anchor: ClockAnchor,
    /// Channel and messages so far, in the order of [`TOPICS`].
    channels: [(u16, u32); TOPICS.len()],
    pub(super) last_flush_ns: Option<u64>,
    message: Vec<u8>,
}

impl RecordingWriter<BufWriter<File>> {
    /// Creates a file; one that exists is left alone.
    ///
    /// # Errors
    /// `file_exists`, `file_unreadable`, `file_failed`.
    pub fn create(path: &Path, anchor: ClockAnchor) -> Result<Self> {
        let name = path.display().to_string();
        let file = File::create_new(path).map_err(|e| HostError::file(&name, "create", &e))?;
        Self::new(BufWriter::new(file), &name, anchor)
    }
}

impl<W: Write + Seek> RecordingWriter<W> {
    /// Starts a recording in `sink`, which errors call `name`.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn new(sink: W, name: &str, anchor: ClockAnchor) -> Result<Self> {
        let failed = |error| write_error(name, error);
        let mut writer = mcap::WriteOptions::new()
            .profile("ros2")
            .library(concat!("wimu ", env!("CARGO_PKG_VERSION")))
            .compression(None)
            .chunk_size(Some(CHUNK_BYTES))
            // Buffers a chunk and appends it whole, instead of going back to write its header.
            .disable_seeking(true)
            .create(sink)
            .map_err(failed)?;
        let schema = writer
            .add_schema(SCHEMA_NAME, "ros2msg", SCHEMA.as_bytes())
            .map_err(failed)?;
        let text = writer
            .add_schema(TEXT_SCHEMA_NAME, "ros2msg", TEXT_SCHEMA.as_bytes())
            .map_err(failed)?;
        let mut metadata = vec![
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("anchor_monotonic_ns", anchor.monotonic_ns.to_string()),
            ("anchor_utc_ns", anchor.utc_ns.to_string()),
        ];
        let mut channels = [(0, 0); TOPICS.len()];
        for (channel, (_, content, topic, key)) in channels.iter_mut().zip(TOPICS) {
            let schema = match content {
                Content::Received | Content::Sent => schema,
                Content::State => text,
            };
            channel.0 = writer
                .add_channel(schema, topic, "cdr", &BTreeMap::new())
                .map_err(failed)?;
            // The channels stand in the first chunk alone: damage there must not lose the rest.
            metadata.push((key, channel.0.to_string()));
        }
        writer
            .write_metadata(&Metadata {
                name: METADATA.to_owned(),
                metadata: metadata
                    .into_iter()
                    .map(|(key, value)| (key.to_owned(), value))
                    .collect(),
            })
            .map_err(failed)?;
        writer.flush().map_err(failed)?;
        Ok(Self {
            name: name.to_owned(),
            writer,
            anchor,
            channels,
            last_flush_ns: None,
            message: Vec::new(),
        })
    }

    /// Appends what the link of `role` received at `host_ns`, ns on the anchored monotonic clock.
    /// Flushes what is a second old.
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
            Recorded::Sent {
                role,
                host_ns,
                bytes,
            } => {
                encode(bytes, &mut message);
                self.write(*role, Content::Sent, *host_ns, &message)
            }
            Recorded::Lost {
                role,
                host_ns,
                reason,
            } => {
                encode_text(&format!("{LOST}{reason}"), &mut message);
                self.write(*role, Content::State, *host_ns, &message)
            }
            Recorded::Connected { role, host_ns } => {
                encode_text(CONNECTED, &mut message);
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
        let wanted =
            |topic: &(LinkRole, Content, &str, &str)| (topic.0, topic.1) == (role, content);
        let index = TOPICS.iter().position(wanted).unwrap_or(0);
        let (channel_id, sequence) = self.channels[index];
        self.channels[index].1 = sequence.wrapping_add(1);
        let log_time = self.anchor.to_utc_ns(host_ns);
        let header = mcap::records::MessageHeader {
            channel_id,
            sequence,
            log_time,
            publish_time: log_time,
        };
        self.writer
            .write_to_known_channel(&header, message)
            .map_err(|error| write_error(&self.name, error))?;
        self.tick(host_ns)
    }

    /// A further topic, of ROS messages in CDR.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn topic(&mut self, name: &str, schema_name: &str, schema: &str) -> Result<Topic> {
        let failed = |error| write_error(&self.name, error);
        let schema = self
            .writer
            .add_schema(schema_name, "ros2msg", schema.as_bytes())
            .map_err(failed)?;
        let channel = self
            .writer
            .add_channel(schema, name, "cdr", &BTreeMap::new())
            .map_err(|error| write_error(&self.name, error))?;
        Ok(Topic(channel))
    }

    /// Appends a message on a further topic that arrived at `host_ns`, on the anchored monotonic
    /// clock, and tells of `stamp_utc_ns`.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn publish(
        &mut self,
        topic: Topic,
        host_ns: u64,
        stamp_utc_ns: u64,
        message: &[u8],
    ) -> Result<()> {
        let header = mcap::records::MessageHeader {
            channel_id: topic.0,
            sequence: 0,
            log_time: self.anchor.to_utc_ns(host_ns),
            publish_time: stamp_utc_ns,
        };
        self.writer
            .write_to_known_channel(&header, message)
            .map_err(|error| write_error(&self.name, error))
    }

    /// Host's monotonic clock to UTC.
    pub fn anchor(&self) -> ClockAnchor {
        self.anchor
    }

    /// Flushes if a second has passed: for the times when nothing is received.
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

    /// Hands everything to the operating system.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn flush(&mut self) -> Result<()> {
        self.writer
            .flush()
            .map_err(|error| write_error(&self.name, error))
    }

    /// Closes the recording with its index.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn finish(mut self) -> Result<W> {
        self.writer
            .finish()
            .map_err(|error| write_error(&self.name, error))?;
        let mut sink = self.writer.into_inner();
        sink.flush()
            .map_err(|error| HostError::file(&self.name, "write", &error))?;
        Ok(sink)
    }
}

fn write_error(name: &str, error: mcap::McapError) -> HostError {
    match error {
        mcap::McapError::Io(error) => HostError::file(name, "write", &error),
        other => HostError::new(
            ErrorCode::FileFailed,
            format!("the recording cannot be written: {other}"),
            "start a new recording",
        )
        .at(name),
    }
}
