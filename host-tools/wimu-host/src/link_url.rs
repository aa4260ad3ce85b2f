//! LINK and input file arguments.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::error::{ErrorCode, HostError, Result};
use crate::fleet::topics::{Broker, Name};
use crate::formats::{self, Source};

/// Default baud rate.
pub const DEFAULT_BAUD: u32 = 115_200;

/// A link to a board.
///
/// | text | meaning |
/// |---|---|
/// | `serial:///dev/ttyACM0?baud=115200`, `serial://COM5` | a serial port; the baud rate is optional |
/// | `serial:///dev/ttyACM0?baud=auto` | the same, at the baud rate of the board, which is searched |
/// | `/dev/ttyACM0`, `/dev/rfcomm0`, `/dev/cu.usbmodem1`, `COM5` | the same, at 115200 baud |
/// | `tcp://127.0.0.1:7100`, `tcp://[::1]:7100` | a TCP server |
/// | `ble://wimu-1a2b`, `ble://D4:7C:12:34:56:78` | a unit with the Nordic UART Service; needs the feature `ble` |
/// | `mqtt://127.0.0.1/hall/board-1`, `mqtts://me@host:8883/hall/board-1` | a board of a fleet, through a broker |
/// | `auto` | the serial port with the USB id of a known board |
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum LinkUrl {
    /// A serial port.
    Serial {
        /// Path or name in the operating system.
        path: String,
        /// Baud rate; `None` to search it.
        baud: Option<u32>,
    },
    /// A TCP server.
    Tcp {
        /// Host name or address, an IPv6 address without brackets.
        host: String,
        /// Port.
        port: u16,
    },
    /// A unit with the Nordic UART Service over Bluetooth Low Energy.
    Ble {
        /// Its name, or its address.
        name: String,
    },
    /// A board of a fleet, through a broker.
    Mqtt {
        /// The broker.
        broker: Broker,
        /// Name of the fleet.
        fleet: Name,
        /// Name of the board.
        board: Name,
    },
    /// The only port with the USB id of a known board.
    Auto,
}

impl FromStr for LinkUrl {
    type Err = HostError;

    fn from_str(text: &str) -> Result<Self> {
        let bad = |message: String| {
            ErrorCode::BadLink.error(message,
                "write serial:///dev/ttyACM0?baud=115200, COM5, /dev/ttyACM0, tcp://127.0.0.1:7100, mqtt://HOST/FLEET/BOARD or auto",
            )
            .at(text)
        };
        if text == "auto" {
            return Ok(Self::Auto);
        }
        if let Some(rest) = text.strip_prefix("serial://") {
            return parse_serial(rest).map_err(bad);
        }
        if let Some(rest) = text.strip_prefix("tcp://") {
            return parse_tcp(rest).map_err(bad);
        }
        if text.starts_with("mqtt://") || text.starts_with("mqtts://") {
            return parse_mqtt(text).map_err(|why| {
                ErrorCode::BadLink.error(why, "write mqtt://HOST/FLEET/BOARD").at(text)
            });
        }
        if let Some(name) = text.strip_prefix("ble://") {
            return parse_ble(name, text).map_err(|error| error.at(text));
        }
        if let Some((scheme, _)) = text.split_once("://") {
            return Err(bad(format!("`{scheme}` is not a kind of link")));
        }
        if text.starts_with("/dev/") || is_com_port(text) {
            return Ok(Self::Serial { path: text.to_owned(), baud: Some(DEFAULT_BAUD) });
        }
        Err(bad("this is not a LINK".to_owned()))
    }
}

fn parse_serial(rest: &str) -> Result<LinkUrl, String> {
    let (path, query) = rest.split_once('?').unwrap_or((rest, ""));
    // `serial:///COM5` has the URL's slash before the name.
    let path = match path.strip_prefix('/') {
        Some(name) if is_com_port(name) => name,
        _ => path,
    };
    if path.is_empty() || path == "/" {
        return Err("the serial port is missing".to_owned());
    }
    let mut baud = Some(DEFAULT_BAUD);
    for pair in query.split('&').filter(|pair| !pair.is_empty()) {
        match pair.split_once('=') {
            Some(("baud", "auto")) => baud = None,
            Some(("baud", value)) => {
                let rate = value.parse().ok().filter(|baud| *baud > 0);
                baud = Some(rate.ok_or_else(|| format!("`{value}` is not a baud rate"))?);
            }
            _ => return Err(format!("`{pair}` is not an option of a serial link")),
        }
    }
    Ok(LinkUrl::Serial { path: path.to_owned(), baud })
}

#[cfg(feature = "ble")]
fn parse_ble(name: &str, _: &str) -> Result<LinkUrl> {
    let missing = || {
        let message = "the name of the unit is missing";
        ErrorCode::BadLink.error(message, "`wimu ports --probe` lists the units in range")
    };
    let name = Some(name.trim_end_matches('/')).filter(|name| !name.is_empty());
    let name = name.ok_or_else(missing)?.to_owned();
    Ok(LinkUrl::Ble { name })
}

#[cfg(not(feature = "ble"))]
fn parse_ble(_: &str, text: &str) -> Result<LinkUrl> {
    Err(crate::transport::without_ble(text))
}

fn parse_tcp(rest: &str) -> Result<LinkUrl, String> {
    let rest = rest.strip_suffix('/').unwrap_or(rest);
    let (host, port) = rest.rsplit_once(':').ok_or_else(|| "the TCP port is missing".to_owned())?;
    let host = match host.strip_prefix('[').and_then(|h| h.strip_suffix(']')) {
        Some(address) => address,
        None if host.contains(':') => {
            return Err("an IPv6 address needs brackets: tcp://[::1]:7100".to_owned());
        }
        None => host,
    };
    if host.is_empty() {
        return Err("the host is missing".to_owned());
    }
    let port = port
        .parse()
        .ok()
        .filter(|port| *port > 0)
        .ok_or_else(|| format!("`{port}` is not a TCP port"))?;
    Ok(LinkUrl::Tcp { host: host.to_owned(), port })
}

fn parse_mqtt(text: &str) -> Result<LinkUrl, String> {
    let (broker, path) = Broker::split(text)?;
    let path = path.strip_suffix('/').unwrap_or(path);
    let (fleet, board) = path.split_once('/').ok_or("the fleet or the board is missing")?;
    let name =
        |what: &str, text: &str| text.parse::<Name>().map_err(|why| format!("the {what}: {why}"));
    Ok(LinkUrl::Mqtt { broker, fleet: name("fleet", fleet)?, board: name("board", board)? })
}

fn is_com_port(text: &str) -> bool {
    text.get(..3).is_some_and(|prefix| prefix.eq_ignore_ascii_case("COM"))
        && text.len() > 3
        && text[3..].bytes().all(|b| b.is_ascii_digit())
}

impl fmt::Display for LinkUrl {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Serial { path, baud: Some(baud) } => write!(out, "serial://{path}?baud={baud}"),
            Self::Serial { path, baud: None } => write!(out, "serial://{path}?baud=auto"),
            Self::Tcp { host, port } if host.contains(':') => write!(out, "tcp://[{host}]:{port}"),
            Self::Tcp { host, port } => write!(out, "tcp://{host}:{port}"),
            Self::Ble { name } => write!(out, "ble://{name}"),
            Self::Mqtt { broker, fleet, board } => write!(out, "{broker}/{fleet}/{board}"),
            Self::Auto => out.write_str("auto"),
        }
    }
}

/// Input of a command: a link, a recording or a CSV file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    /// A live board.
    Link(LinkUrl),
    /// A recording of wimu, detected by content.
    Recording(PathBuf),
    /// Any other file or folder.
    File(PathBuf),
}

impl Input {
    /// Distinguishes a LINK from a file, and a recording of wimu from others by its first bytes.
    ///
    /// # Errors
    /// A LINK's own errors; `file_unreadable` when it is neither a LINK nor a readable file.
    pub fn parse(text: &str) -> Result<Self> {
        let path = Path::new(text);
        if text == "auto" || text.contains("://") || !path.exists() {
            return match text.parse() {
                Ok(link) => Ok(Self::Link(link)),
                Err(error) if text.contains("://") => Err(error),
                Err(_) => Err(ErrorCode::FileUnreadable.error("there is no such file, and it is not a LINK",
                    "name a recording (.mcap), a CSV file, or a LINK such as /dev/ttyACM0 or tcp://127.0.0.1:7100",
                )
                .at(text)),
            };
        }
        Ok(match formats::wimu::detect(&Source::open(path)?) {
            true => Self::Recording(path.to_owned()),
            false => Self::File(path.to_owned()),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn serial(path: &str, baud: u32) -> LinkUrl {
        LinkUrl::Serial { path: path.to_owned(), baud: Some(baud) }
    }

    #[test]
    fn the_rate_may_be_found() {
        let auto = LinkUrl::Serial { path: "/dev/ttyACM0".to_owned(), baud: None };
        let text = "serial:///dev/ttyACM0?baud=auto";
        assert_eq!(text.parse::<LinkUrl>().unwrap(), auto);
        assert_eq!(auto.to_string(), text);
    }

    fn tcp(host: &str, port: u16) -> LinkUrl {
        LinkUrl::Tcp { host: host.to_owned(), port }
    }

    #[test]
    fn every_documented_form_parses_and_prints_back() {
        for (text, link) in [
            ("serial:///dev/ttyACM0?baud=9600", serial("/dev/ttyACM0", 9600)),
            ("serial:///dev/ttyACM0", serial("/dev/ttyACM0", 115_200)),
            ("serial://COM5", serial("COM5", 115_200)),
            ("serial:///COM5?baud=115200", serial("COM5", 115_200)),
            ("COM12", serial("COM12", 115_200)),
            ("/dev/rfcomm0", serial("/dev/rfcomm0", 115_200)),
            ("/dev/cu.usbmodem1", serial("/dev/cu.usbmodem1", 115_200)),
            ("tcp://127.0.0.1:7100", tcp("127.0.0.1", 7100)),
            ("tcp://localhost:1/", tcp("localhost", 1)),
            ("tcp://[::1]:7100", tcp("::1", 7100)),
            (
                "mqtts://me@host/hall/b-1",
                LinkUrl::Mqtt {
                    broker: "mqtts://me@host:8883".parse().unwrap(),
                    fleet: "hall".parse().unwrap(),
                    board: "b-1".parse().unwrap(),
                },
            ),
            ("auto", LinkUrl::Auto),
        ] {
            let parsed: LinkUrl = text.parse().unwrap();
            assert_eq!(parsed, link, "{text}");
            assert_eq!(parsed.to_string().parse::<LinkUrl>().unwrap(), link);
        }
    }

    #[test]
    fn what_is_no_link_says_what_is_wrong() {
        for (text, code, part) in [
            ("serial://", ErrorCode::BadLink, "port is missing"),
            ("serial:///dev/ttyS0?baud=fast", ErrorCode::BadLink, "`fast`"),
            ("serial:///dev/ttyS0?baud=0", ErrorCode::BadLink, "`0`"),
            ("serial:///dev/ttyS0?parity=even", ErrorCode::BadLink, "parity=even"),
            ("tcp://127.0.0.1", ErrorCode::BadLink, "port is missing"),
            ("tcp://::1:7100", ErrorCode::BadLink, "brackets"),
            ("tcp://:7100", ErrorCode::BadLink, "host is missing"),
            ("tcp://host:99999", ErrorCode::BadLink, "99999"),
            ("mqtt://host/hall", ErrorCode::BadLink, "missing"),
            ("mqtt://host/hall/#", ErrorCode::BadLink, "'#'"),
            ("mqtt://host/a/b/c", ErrorCode::BadLink, "'/'"),
            ("mqtt:///hall/b", ErrorCode::BadLink, "host is missing"),
            #[cfg(not(feature = "ble"))]
            ("ble://wimu", ErrorCode::LinkKindMissing, "Low Energy"),
            #[cfg(feature = "ble")]
            ("ble:///", ErrorCode::BadLink, "name of the unit"),
            ("http://host", ErrorCode::BadLink, "`http`"),
            ("COMX", ErrorCode::BadLink, "not a LINK"),
            ("", ErrorCode::BadLink, "not a LINK"),
            ("²²", ErrorCode::BadLink, "not a LINK"),
        ] {
            let error = text.parse::<LinkUrl>().unwrap_err();
            assert_eq!(error.code(), code, "{text}");
            assert!(error.message().contains(part), "{text}: {error}");
            assert_eq!(error.exit_code(), 2);
        }
    }

    #[test]
    fn an_input_that_is_neither_file_nor_link_is_told_both() {
        let error = Input::parse("no/such/file.csv").unwrap_err();
        assert_eq!(error.code(), ErrorCode::FileUnreadable);
        assert!(error.remedy().contains("LINK"));
        assert_eq!(
            Input::parse("tcp://127.0.0.1:7100").unwrap(),
            Input::Link(tcp("127.0.0.1", 7100))
        );
        #[cfg(not(feature = "ble"))]
        {
            let error = Input::parse("ble://x").unwrap_err();
            assert_eq!(error.code(), ErrorCode::LinkKindMissing);
            assert!(error.remedy().contains("--features ble"), "{error}");
        }
        #[cfg(feature = "ble")]
        {
            let name = "wimu-1a2b".to_owned();
            let link = LinkUrl::Ble { name };
            assert_eq!(link.to_string(), "ble://wimu-1a2b");
            assert_eq!(Input::parse("ble://wimu-1a2b").unwrap(), Input::Link(link));
        }
    }
}
