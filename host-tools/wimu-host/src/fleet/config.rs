//! The file that `wimu gateway` reads.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Deserialize;
use toml::Spanned;

use super::topics::{Broker, Name};
use crate::{ErrorCode, HostError, LinkUrl, Result};

/// What a gateway does.
///
/// ```
/// use std::path::Path;
/// use wimu_host::fleet::config::GatewayConfig;
///
/// let config = GatewayConfig::parse(
///     r#"
///     fleet = "hall"                   # required
///     broker = "mqtt://127.0.0.1"      # required: mqtt://USER@HOST:PORT, mqtts:// in builds with TLS
///     gateway = "north"                # name of this gateway; default `gateway`
///     recordings = "recordings"        # folder, beside this file; without it nothing is recorded
///     rotate_minutes = 60              # a new file for each board after this time
///     spool = "spool"                  # folder for messages while the broker is away; in memory without
///     spool_mb = 256                   # most of them; the oldest are dropped first
///     batch_ms = 1000                  # data are published at least this often
///     metrics = "127.0.0.1:9180"       # address for Prometheus
///
///     [boards]                         # name = LINK
///     left-arm = "tcp://127.0.0.1:7100"
///     right-arm = "serial:///dev/ttyACM0"
///     "#,
///     Path::new("fleet.toml"),
/// )?;
/// assert_eq!(config.boards.len(), 2);
/// # Ok::<(), wimu_host::HostError>(())
/// ```
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct GatewayConfig {
    /// Name of the fleet.
    pub fleet: Name,
    /// Name of this gateway in the fleet.
    pub gateway: Name,
    /// The broker.
    pub broker: Broker,
    /// Folder of the recordings.
    pub recordings: Option<PathBuf>,
    /// Longest time of a file.
    pub rotate: Duration,
    /// Folder of messages that wait for the broker.
    pub spool: Option<PathBuf>,
    /// Most bytes that wait.
    pub spool_bytes: u64,
    /// Longest time from a read to its publication.
    pub batch: Duration,
    /// Address of the metrics.
    pub metrics: Option<SocketAddr>,
    /// The boards with their links.
    pub boards: BTreeMap<Name, LinkUrl>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Text {
    fleet: Spanned<String>,
    broker: Spanned<String>,
    gateway: Option<Spanned<String>>,
    recordings: Option<PathBuf>,
    rotate_minutes: Option<Spanned<u64>>,
    spool: Option<PathBuf>,
    spool_mb: Option<Spanned<u64>>,
    batch_ms: Option<Spanned<u64>>,
    metrics: Option<Spanned<String>>,
    boards: BTreeMap<Spanned<String>, Spanned<String>>,
}

impl GatewayConfig {
    /// Reads a file. Its folders are relative to it.
    ///
    /// # Errors
    /// `file_unreadable`; those of [`parse`](Self::parse).
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path)
            .map_err(|error| HostError::file(&name, "read", &error))?;
        Self::parse(&text, path)
    }

    /// Reads the text of the file at `path`.
    ///
    /// # Errors
    /// `bad_config` with file and line.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let file = File { text, path };
        let found: Text = toml::from_str(text).map_err(|error| {
            file.error(
                error.span().map_or(0, |span| span.start),
                error.message().lines().next().unwrap_or_default(),
            )
        })?;
        let beside = |folder: PathBuf| path.parent().unwrap_or(Path::new("")).join(folder);
        let number =
            |value: Option<Spanned<u64>>, default: u64, [least, most]: [u64; 2]| match value {
                Some(value) if !(least..=most).contains(value.get_ref()) => Err(file.error(
                    value.span().start,
                    &format!("{} is not within {least} to {most}", value.get_ref()),
                )),
                value => Ok(value.map_or(default, Spanned::into_inner)),
            };
        let mut boards: BTreeMap<Name, LinkUrl> = BTreeMap::new();
        for (board, link) in &found.boards {
            let name = file.read::<Name>(board)?;
            let url = link.get_ref().parse::<LinkUrl>();
            let url = url.map_err(|error| file.error(link.span().start, error.message()))?;
            let trouble = match &url {
                LinkUrl::Auto | LinkUrl::Serial { baud: None, .. } => {
                    "a gateway needs the port and its baud rate"
                }
                LinkUrl::Mqtt { .. } => "a gateway needs a link to the board itself",
                _ if boards.values().any(|other| *other == url) => "another board has this LINK",
                _ => {
                    boards.insert(name, url);
                    continue;
                }
            };
            return Err(file.error(link.span().start, trouble));
        }
        if boards.is_empty() {
            return Err(file.error(0, "there is no board: write [boards] and NAME = \"LINK\""));
        }
        let metrics = found
            .metrics
            .as_ref()
            .map(|text| file.read(text))
            .transpose()?;
        let gateway = found
            .gateway
            .as_ref()
            .map(|text| file.read(text))
            .transpose()?;
        Ok(Self {
            fleet: file.read(&found.fleet)?,
            gateway: match gateway {
                Some(name) => name,
                None => "gateway"
                    .parse()
                    .map_err(|why: String| file.error(0, &why))?,
            },
            broker: file.read(&found.broker)?,
            recordings: found.recordings.map(beside),
            rotate: Duration::from_secs(60 * number(found.rotate_minutes, 60, [1, 7 * 24 * 60])?),
            spool: found.spool.map(beside),
            spool_bytes: number(found.spool_mb, 256, [2, 1 << 20])? << 20,
            batch: Duration::from_millis(number(found.batch_ms, 1000, [10, 60_000])?),
            metrics,
            boards,
        })
    }
}

/// A text with its file, for errors.
struct File<'a> {
    text: &'a str,
    path: &'a Path,
}

impl File<'_> {
    fn read<T: std::str::FromStr>(&self, text: &Spanned<String>) -> Result<T>
    where
        T::Err: std::fmt::Display,
    {
        let wrong =
            |why: T::Err| self.error(text.span().start, &format!("`{}`: {why}", text.get_ref()));
        text.get_ref().parse().map_err(wrong)
    }

    fn error(&self, at: usize, message: &str) -> HostError {
        let before = self.text.get(..at).unwrap_or_default();
        let line = before.matches('\n').count() + 1;
        ErrorCode::BadConfig
            .error(message, "see `wimu gateway --help` for an example")
            .at(format!("{}, line {line}", self.path.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<GatewayConfig> {
        GatewayConfig::parse(text, Path::new("dir/fleet.toml"))
    }

    const HEAD: &str = "fleet = \"hall\"\nbroker = \"mqtt://127.0.0.1\"\n";

    #[test]
    fn a_minimal_file_has_defaults_and_folders_are_beside_it() {
        let config = read(&format!(
            "{HEAD}recordings = \"r\"\n[boards]\na = \"tcp://127.0.0.1:7100\"\n"
        ))
        .unwrap();
        assert_eq!(config.recordings.as_deref(), Some(Path::new("dir/r")));
        assert_eq!(
            (config.batch, config.rotate),
            (Duration::from_secs(1), Duration::from_secs(3600))
        );
        assert_eq!(config.gateway.as_str(), "gateway");
    }

    #[test]
    fn every_error_names_its_line() {
        let boards = "[boards]\na = \"tcp://127.0.0.1:7100\"\n";
        for (text, line, part) in [
            ("fleet = \"hall\"\n[boards]\n", 1, "broker"),
            (&format!("{HEAD}color = 1\n{boards}"), 3, "color"),
            (&format!("{HEAD}batch_ms = 5\n{boards}"), 3, "10 to 60000"),
            (&format!("{HEAD}metrics = \"here\"\n{boards}"), 3, "here"),
            (
                &format!("{HEAD}{boards}\"a/+\" = \"tcp://127.0.0.1:7101\"\n"),
                5,
                "a/+",
            ),
            (
                &format!("{HEAD}{boards}b = \"tcp://127.0.0.1:7100\"\n"),
                5,
                "another board",
            ),
            (&format!("{HEAD}{boards}b = \"auto\"\n"), 5, "port"),
            (
                &format!("{HEAD}{boards}b = \"mqtt://h/f/b\"\n"),
                5,
                "itself",
            ),
            (
                &format!("{HEAD}{boards}a = \"tcp://127.0.0.1:7102\"\n"),
                5,
                "duplicate",
            ),
            (
                "fleet = \"#\"\nbroker = \"mqtt://h\"\n[boards]\na = \"COM1\"\n",
                1,
                "#",
            ),
            (&format!("{HEAD}[boards]\n"), 1, "no board"),
            ("fleet = \n", 1, ""),
        ] {
            let error = read(text).unwrap_err();
            assert_eq!(error.code(), ErrorCode::BadConfig);
            assert!(error.message().contains(part), "{text}: {error}");
            assert_eq!(
                error.location(),
                Some(&*format!("dir/fleet.toml, line {line}")),
                "{error}"
            );
        }
    }
}
