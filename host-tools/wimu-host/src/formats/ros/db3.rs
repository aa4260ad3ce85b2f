//! ROS 2 bags in sqlite, with the feature `sqlite`: a file, or a folder with `metadata.yaml` and files in sequence.

use super::mcap::files;
use super::{ReadOptions, Source};
use crate::Result;
use crate::recording::Sink;

const MAGIC: &[u8] = b"SQLite format 3\0";

/// Databases of sqlite.
pub(in crate::formats) fn detect(source: &Source) -> bool {
    !files(source, MAGIC).is_empty()
}

/// Refuses the file.
#[cfg(not(feature = "sqlite"))]
pub(in crate::formats) fn read(
    source: &Source,
    _options: &ReadOptions,
    _sink: &mut dyn Sink,
) -> Result<()> {
    Err(crate::Code::FeatureMissing
        .error(
            "this build does not read ROS 2 bags in sqlite (.db3)",
            "convert it: `pip install rosbags`, `rosbags-convert --src BAG_FOLDER --dst NEW --dst-storage mcap` (or \
             `ros2 bag convert`), or build wimu with `--features wimu-host/sqlite`",
        )
        .at(source.name()))
}

#[cfg(feature = "sqlite")]
pub(in crate::formats) use with_sqlite::read;

#[cfg(feature = "sqlite")]
mod with_sqlite {
    use std::collections::BTreeMap;
    use std::io;
    use std::path::{Path, PathBuf};

    use rusqlite::{Connection, OpenFlags};

    use super::super::Messages;
    use super::*;
    use crate::Problem;
    use crate::ros::message::Encoding;

    /// Hands the messages to the sink.
    pub(in crate::formats) fn read(
        source: &Source,
        options: &ReadOptions,
        sink: &mut dyn Sink,
    ) -> Result<()> {
        let mut messages = Messages::new(source, options, sink);
        for file in files(source, MAGIC) {
            // Bytes of an archive's member are copied to a file: sqlite reads files.
            let (path, _copy) = match file.path() {
                Some(path) => (path.to_owned(), None),
                None => {
                    let copy = copy(file)?;
                    (copy.path().to_owned(), Some(copy))
                }
            };
            if let Err(error) = walk(&path, &mut messages) {
                messages.damage.add(format!("{}: {error}", file.name()));
            }
        }
        messages.finish()
    }

    fn copy(file: &Source) -> Result<tempfile::NamedTempFile> {
        let failed = |error: io::Error| Problem::file(file.name(), "copy", &error);
        let mut copy = tempfile::NamedTempFile::new().map_err(failed)?;
        io::copy(&mut file.reader()?, &mut copy).map_err(failed)?;
        Ok(copy)
    }

    /// The location of a file that nothing writes, so that no lock or journal beside it is needed.
    fn location(path: &Path) -> PathBuf {
        let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let text = path.to_string_lossy();
        let text = text.replace('%', "%25").replace('?', "%3f").replace('#', "%23");
        format!("file:{text}?immutable=1").into()
    }

    fn walk(path: &Path, messages: &mut Messages<'_>) -> rusqlite::Result<()> {
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY
            | OpenFlags::SQLITE_OPEN_URI
            | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let base = Connection::open_with_flags(location(path), flags)?;
        let mut topics = BTreeMap::new();
        let mut query = base.prepare("SELECT id, name, type, serialization_format FROM topics")?;
        let mut rows = query.query([])?;
        while let Some(row) = rows.next()? {
            let (id, name): (i64, String) = (row.get(0)?, row.get(1)?);
            let (message, format): (String, String) = (row.get(2)?, row.get(3)?);
            let encoding = (format == "cdr").then_some(Encoding::Cdr);
            topics.insert(id, messages.topic(&name, &message, encoding));
        }
        let mut query = base.prepare("SELECT topic_id, timestamp, data FROM messages")?;
        let mut rows = query.query([])?;
        while let Some(row) = rows.next()? {
            let (topic, log_ns): (i64, i64) = (row.get(0)?, row.get(1)?);
            if let (Some(topic), Ok(data)) = (topics.get(&topic), row.get_ref(2)?.as_blob()) {
                messages.message(*topic, log_ns, data);
            }
        }
        Ok(())
    }
}
