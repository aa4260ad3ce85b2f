//! The file that `wimu fleet gateway` reads.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer};
use toml::Spanned;

use super::topics::{Broker, Name};
use crate::{Code, LinkUrl, Problem, Result};

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
///     spool = "spool"                  # folder for messages while the broker is away; they are in spool/GATEWAY
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
/// # Ok::<(), wimu_host::Problem>(())
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
    pub spool: PathBuf,
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
    fleet: Parsed<Name>,
    broker: Parsed<Broker>,
    gateway: Option<Parsed<Name>>,
    recordings: Option<PathBuf>,
    #[serde(default)]
    rotate_minutes: Within<60, 1, 10_080>,
    spool: Option<PathBuf>,
    #[serde(default)]
    spool_mb: Within<256, 2, 1_048_576>,
    #[serde(default)]
    batch_ms: Within<1000, 10, 60_000>,
    metrics: Option<Parsed<SocketAddr>>,
    boards: BTreeMap<Parsed<Name>, Spanned<Parsed<LinkUrl>>>,
}

/// What a text says, or why it does not.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Parsed<T>(T);

impl<'de, T: FromStr<Err: Display>> Deserialize<'de> for Parsed<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        let wrong = |why| D::Error::custom(format!("`{text}`: {why}"));
        text.parse().map(Self).map_err(wrong)
    }
}

/// A number with its default, least and greatest value.
#[derive(Deserialize)]
#[serde(try_from = "u64")]
struct Within<const DEFAULT: u64, const LEAST: u64, const MOST: u64>(u64);

impl<const DEFAULT: u64, const LEAST: u64, const MOST: u64> Default
    for Within<DEFAULT, LEAST, MOST>
{
    fn default() -> Self {
        Self(DEFAULT)
    }
}

impl<const DEFAULT: u64, const LEAST: u64, const MOST: u64> TryFrom<u64>
    for Within<DEFAULT, LEAST, MOST>
{
    type Error = String;

    fn try_from(number: u64) -> Result<Self, String> {
        if (LEAST..=MOST).contains(&number) {
            Ok(Self(number))
        } else {
            Err(format!("{number} is not within {LEAST} to {MOST}"))
        }
    }
}

impl GatewayConfig {
    /// Reads a file. Its folders are relative to it.
    ///
    /// # Errors
    /// `file_unreadable`; those of [`parse`](Self::parse).
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let text =
            std::fs::read_to_string(path).map_err(|error| Problem::file(&name, "read", &error))?;
        Self::parse(&text, path)
    }

    /// Reads the text of the file at `path`.
    ///
    /// # Errors
    /// `bad_config` with file and line.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let failed = |at: usize, message: &str| {
            let line = text.get(..at).unwrap_or_default().matches('\n').count() + 1;
            Code::BadConfig
                .error(
                    message,
                    "see `wimu fleet gateway --help` for an example; write [boards] last",
                )
                .at(format!("{}, line {line}", path.display()))
        };
        let found: Text = toml::from_str(text).map_err(|error| {
            let at = error.span().map_or(0, |span| span.start);
            failed(at, error.message().lines().next().unwrap_or_default())
        })?;
        let mut boards: BTreeMap<Name, LinkUrl> = BTreeMap::new();
        for (board, link) in found.boards {
            let (at, url) = (link.span().start, link.into_inner().0);
            let same = |other: &Name| other.as_str().eq_ignore_ascii_case(board.0.as_str());
            let trouble = match &url {
                LinkUrl::Auto => "a gateway needs the port",
                LinkUrl::Mqtt { .. } => "a gateway needs a link to the board itself",
                _ if boards.values().any(|other| *other == url) => "another board has this LINK",
                _ if boards.keys().any(same) => {
                    "another board's name differs in upper and lower case only"
                }
                _ => {
                    boards.insert(board.0, url);
                    continue;
                }
            };
            return Err(failed(at, trouble));
        }
        if boards.is_empty() {
            return Err(failed(0, "there is no board: write [boards] and NAME = \"LINK\""));
        }
        let beside = |folder: PathBuf| path.parent().unwrap_or(Path::new("")).join(folder);
        let gateway = found.gateway.map_or_else(Name::gateway, |name| name.0);
        let spool = found.spool.unwrap_or_else(|| "spool".into());
        Ok(Self {
            fleet: found.fleet.0,
            spool: beside(spool).join(gateway.as_str()),
            gateway,
            broker: found.broker.0,
            recordings: found.recordings.map(beside),
            rotate: Duration::from_secs(60 * found.rotate_minutes.0),
            spool_bytes: found.spool_mb.0 << 20,
            batch: Duration::from_millis(found.batch_ms.0),
            metrics: found.metrics.map(|address| address.0),
            boards,
        })
    }
}
