//! Names and topics of a fleet, and the address of its broker.

use std::fmt;
use std::str::FromStr;

use crate::{Code, Result};

/// Longest name of a fleet, a board or a gateway, bytes.
pub const MAX_NAME: usize = 64;
/// Port of a broker without and with TLS.
const PORTS: [u16; 2] = [1883, 8883];

/// Name of a fleet, a board or a gateway: 1 to 64 letters, digits, `-`, `_` and `.`, beginning with a letter or digit.
/// So a name is one level of a topic, no wildcard (`+`, `#`), and a file name on every system.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Name(String);

impl Name {
    /// The default name of a gateway.
    pub fn gateway() -> Self {
        Self("gateway".to_owned())
    }

    /// The text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for Name {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.0)
    }
}

impl FromStr for Name {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let allowed = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        let begins = text.starts_with(|c: char| c.is_ascii_alphanumeric());
        if text.is_empty() {
            Err("the name is empty".to_owned())
        } else if let Some(wrong) = text.chars().find(|c| !allowed(*c)) {
            Err(format!("a name has letters, digits, `-`, `_` and `.`, not {wrong:?}"))
        } else if !begins || text.ends_with('.') {
            Err("a name begins with a letter or digit, and does not end with `.`".to_owned())
        } else if text.len() > MAX_NAME {
            Err(format!("a name has at most {MAX_NAME} characters"))
        } else {
            Ok(Self(text.to_owned()))
        }
    }
}

/// Content of a topic of a board, `wimu/FLEET/BOARD/…`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// Batches of received bytes.
    Up,
    /// Frames to the board.
    Down,
    /// Retained state: birth, statistics, death.
    State,
}

impl Content {
    fn name(self) -> &'static str {
        match self {
            Self::Up => "up",
            Self::Down => "down",
            Self::State => "state",
        }
    }
}

/// Topic of a board.
pub fn topic(fleet: &Name, board: &Name, content: Content) -> String {
    format!("wimu/{fleet}/{board}/{}", content.name())
}

/// Topic filter of all boards of a fleet.
pub fn all_boards(fleet: &Name, content: Content) -> String {
    format!("wimu/{fleet}/+/{}", content.name())
}

/// Topic of a gateway's retained state, which is its last will. No board has such a name.
pub fn gateway_topic(fleet: &Name, gateway: &Name) -> String {
    format!("wimu/{fleet}/_gateway/{gateway}")
}

/// Topic filter of the states of all gateways of a fleet.
pub fn all_gateways(fleet: &Name) -> String {
    format!("wimu/{fleet}/_gateway/+")
}

/// The board of a topic of this fleet and content.
pub fn board_of(topic: &str, fleet: &Name, content: Content) -> Option<Name> {
    let rest = topic.strip_prefix("wimu/")?.strip_prefix(fleet.as_str())?;
    let (board, kind) = rest.strip_prefix('/')?.split_once('/')?;
    (kind == content.name()).then(|| board.parse().ok()).flatten()
}

/// Address of a broker: `mqtt://HOST`, `mqtt://USER@HOST:PORT`, or `mqtts://…` with TLS. The password of `USER` is in the
/// environment variable `WIMU_MQTT_PASSWORD`, so that no list of processes shows it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Broker {
    /// User name.
    pub user: Option<String>,
    /// Host name or address, an IPv6 address without brackets.
    pub host: String,
    /// Port.
    pub port: u16,
    /// Whether the connection is encrypted.
    pub tls: bool,
}

impl Broker {
    /// Splits `mqtt://HOST/REST` into the broker and the rest.
    ///
    /// # Errors
    /// What is wrong with the address.
    pub fn split(text: &str) -> Result<(Self, &str), String> {
        let (tls, rest) = match (text.strip_prefix("mqtt://"), text.strip_prefix("mqtts://")) {
            (Some(rest), _) => (false, rest),
            (_, Some(rest)) => (true, rest),
            _ => return Err("a broker begins with mqtt:// or mqtts://".to_owned()),
        };
        let (authority, path) = rest.split_once('/').unwrap_or((rest, ""));
        let (user, address) = match authority.rsplit_once('@') {
            Some((user, address)) => (Some(user.to_owned()), address),
            None => (None, authority),
        };
        if user.as_ref().is_some_and(|user| user.is_empty() || user.contains(':')) {
            return Err("write USER@HOST; the password is in WIMU_MQTT_PASSWORD".to_owned());
        }
        let bracketed = address.strip_prefix('[').and_then(|rest| rest.split_once(']'));
        let (host, port) = match bracketed {
            Some((host, "")) => (host, None),
            Some((host, rest)) => (host, Some(rest.strip_prefix(':').unwrap_or(rest))),
            None => match address.split_once(':') {
                Some((host, port)) => (host, Some(port)),
                None => (address, None),
            },
        };
        if host.is_empty() {
            return Err("the broker's host is missing".to_owned());
        }
        let port = match port {
            None => PORTS[usize::from(tls)],
            Some(text) => {
                let port = text.parse().ok().filter(|port| *port > 0);
                port.ok_or_else(|| format!("`{text}` is not a TCP port"))?
            }
        };
        let broker = Self { user, host: host.to_owned(), port, tls };
        Ok((broker, path))
    }
}

impl FromStr for Broker {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match Self::split(text)? {
            (broker, "") => Ok(broker),
            (_, path) => Err(format!("`/{path}` does not belong to a broker's address")),
        }
    }
}

impl fmt::Display for Broker {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(if self.tls { "mqtts://" } else { "mqtt://" })?;
        if let Some(user) = &self.user {
            write!(out, "{user}@")?;
        }
        if self.host.contains(':') {
            write!(out, "[{}]:{}", self.host, self.port)
        } else {
            write!(out, "{}:{}", self.host, self.port)
        }
    }
}

/// A fleet at a broker: `mqtt://HOST/FLEET`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fleet {
    /// The broker.
    pub broker: Broker,
    /// Name of the fleet.
    pub fleet: Name,
}

impl FromStr for Fleet {
    type Err = crate::Problem;

    fn from_str(text: &str) -> Result<Self> {
        let bad =
            |message: String| (Code::BadLink.error(message, "write mqtt://HOST/FLEET")).at(text);
        let (broker, fleet) = Broker::split(text).map_err(bad)?;
        let fleet = fleet.strip_suffix('/').unwrap_or(fleet).parse();
        Ok(Self { broker, fleet: fleet.map_err(|why| bad(format!("the fleet: {why}")))? })
    }
}
