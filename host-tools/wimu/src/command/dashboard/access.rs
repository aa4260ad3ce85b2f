//! Who may use the dashboard. Pure functions, so that every refusal has a test.

use std::net::{IpAddr, SocketAddr};

use wimu_host::Result;

/// Characters of a token: 128 bits.
const TOKEN_BYTES: usize = 16;

/// The secret that a page needs for writes. Made at each start, shown in the URL.
pub struct Token(String);

impl Token {
    /// A new one of the operating system's random generator.
    ///
    /// # Errors
    /// Those of [`wimu_host::keys::random`].
    pub fn generate() -> Result<Self> {
        let mut bytes = [0; TOKEN_BYTES];
        wimu_host::keys::random(&mut bytes)?;
        Ok(Self(bytes.iter().map(|byte| format!("{byte:02x}")).collect()))
    }

    /// As it is in the URL.
    pub fn text(&self) -> &str {
        &self.0
    }

    /// Whether a page has it, in a time that does not depend on the text.
    pub fn is(&self, text: &str) -> bool {
        let (ours, theirs) = (self.0.as_bytes(), text.as_bytes());
        let differ = ours.iter().zip(theirs).fold(0, |sum, (a, b)| sum | (a ^ b));
        std::hint::black_box(differ) == 0 && ours.len() == theirs.len()
    }
}

/// What a request asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// A file of the page, by its index in [`FILES`].
    File(usize),
    /// A WebSocket.
    Socket,
}

/// Why a request is refused: a status of HTTP.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// Not HTTP, or a required header is absent or repeated.
    Malformed,
    /// The host that the page was asked for is not this computer: DNS rebinding.
    ForeignHost,
    /// A page of another site asks.
    ForeignOrigin,
    NotFound,
    /// Not GET.
    Method,
}

impl Refusal {
    /// Status line of HTTP.
    pub fn status(self) -> &'static str {
        match self {
            Self::Malformed => "400 Bad Request",
            Self::ForeignHost | Self::ForeignOrigin => "403 Forbidden",
            Self::NotFound => "404 Not Found",
            Self::Method => "405 Method Not Allowed",
        }
    }
}

/// Paths of the files, in the order in which the server holds them.
pub const FILES: [&str; 4] = ["/", "/style.css", "/plot.js", "/dashboard.js"];

/// The head of a request.
pub struct Head<'a> {
    pub method: &'a str,
    pub path: &'a str,
    /// Names and values.
    pub headers: &'a [(&'a str, &'a str)],
}

impl<'a> Head<'a> {
    /// The value of a header that is there once at most.
    fn one(&self, name: &str) -> std::result::Result<Option<&'a str>, Refusal> {
        let mut found = self.headers.iter().filter(|(n, _)| n.eq_ignore_ascii_case(name));
        match (found.next(), found.next()) {
            (first, None) => Ok(first.map(|(_, value)| *value)),
            _ => Err(Refusal::Malformed),
        }
    }

    /// The key of a request for a WebSocket.
    pub fn socket_key(&self) -> Option<&'a str> {
        let has = |name, wanted: &str| {
            let value = self.one(name).ok().flatten().unwrap_or_default();
            value.split(',').any(|part| part.trim().eq_ignore_ascii_case(wanted))
        };
        let is_upgrade = has("Upgrade", "websocket") && has("Connection", "upgrade");
        let key = self.one("Sec-WebSocket-Key").ok().flatten();
        key.filter(|_| is_upgrade && has("Sec-WebSocket-Version", "13"))
    }
}

/// Whether a request that was sent to `address` is answered.
///
/// `Host` must be an address or `localhost`, never another name, because a name can be rebound to this computer; and
/// loopback where the server is. A WebSocket needs an `Origin` that is this server, and any other request none that is
/// not.
///
/// # Errors
/// The reason of the refusal.
pub fn check(head: &Head, address: SocketAddr) -> std::result::Result<Target, Refusal> {
    let host = head.one("Host")?.ok_or(Refusal::Malformed)?;
    if !is_ours(host, address) {
        return Err(Refusal::ForeignHost);
    }
    let origin = head.one("Origin")?;
    let same = origin.map(|origin| origin.strip_prefix("http://") == Some(host));
    let path = head.path.split('?').next().unwrap_or_default();
    let target = match FILES.iter().position(|file| *file == path) {
        Some(file) => Target::File(file),
        None if path == "/socket" => Target::Socket,
        None => return Err(Refusal::NotFound),
    };
    match (target, same) {
        (_, Some(false)) | (Target::Socket, None) => return Err(Refusal::ForeignOrigin),
        _ => {}
    }
    if head.method != "GET" {
        return Err(Refusal::Method);
    }
    if target == Target::Socket && head.socket_key().is_none() {
        return Err(Refusal::Malformed);
    }
    Ok(target)
}

fn is_ours(host: &str, address: SocketAddr) -> bool {
    let (name, port) = match host.rsplit_once(':') {
        Some((name, port)) if !port.contains(']') => (name, port.parse().ok()),
        _ => (host, Some(80)),
    };
    let bare = name.trim_start_matches('[').trim_end_matches(']');
    let is_named = name.eq_ignore_ascii_case("localhost")
        || bare.parse().is_ok_and(|ip: IpAddr| ip.is_loopback() || !address.ip().is_loopback());
    is_named && port == Some(address.port())
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: &str = "dGhlIHNhbXBsZSBub25jZQ==";

    fn checked(path: &str, headers: &[(&str, &str)]) -> std::result::Result<Target, Refusal> {
        let address = SocketAddr::from(([127, 0, 0, 1], 7180));
        check(&Head { method: "GET", path, headers }, address)
    }

    /// A request for the socket with this host and origin.
    fn socket(host: &str, origin: Option<&str>) -> std::result::Result<Target, Refusal> {
        let mut headers = vec![
            ("Host", host),
            ("Upgrade", "websocket"),
            ("Connection", "keep-alive, Upgrade"),
            ("Sec-WebSocket-Version", "13"),
            ("Sec-WebSocket-Key", KEY),
        ];
        headers.extend(origin.map(|origin| ("Origin", origin)));
        checked("/socket", &headers)
    }

    #[test]
    fn only_this_computer_by_its_address_is_a_host() {
        for host in ["127.0.0.1:7180", "localhost:7180", "LocalHost:7180", "[::1]:7180"] {
            assert_eq!(checked("/", &[("Host", host)]), Ok(Target::File(0)), "{host}");
        }
        for host in [
            "evil.example:7180",
            "localhost.evil.example:7180",
            "127.0.0.1.nip.io:7180",
            "127.0.0.1:7181",
            "127.0.0.1",
            "192.168.1.5:7180",
            "localhost:7180@evil.example",
            "",
        ] {
            assert_eq!(checked("/", &[("Host", host)]), Err(Refusal::ForeignHost), "{host}");
        }
        assert_eq!(checked("/", &[]), Err(Refusal::Malformed));
        let twice = [("Host", "127.0.0.1:7180"), ("host", "evil.example")];
        assert_eq!(checked("/", &twice), Err(Refusal::Malformed));
    }

    #[test]
    fn with_listen_a_host_is_any_address_but_no_name() {
        let address = SocketAddr::from(([0, 0, 0, 0], 7180));
        let of = |host| {
            let headers = [("Host", host)];
            check(&Head { method: "GET", path: "/", headers: &headers }, address)
        };
        assert_eq!(of("192.168.1.5:7180"), Ok(Target::File(0)));
        assert_eq!(of("pi.local:7180"), Err(Refusal::ForeignHost));
    }

    #[test]
    fn a_socket_is_for_the_page_of_this_server_only() {
        let host = "127.0.0.1:7180";
        assert_eq!(socket(host, Some("http://127.0.0.1:7180")), Ok(Target::Socket));
        for origin in [
            None,
            Some("null"),
            Some("http://evil.example"),
            Some("http://127.0.0.1:8080"),
            Some("https://127.0.0.1:7180"),
            Some("http://localhost:7180"),
            Some("http://127.0.0.1:7180.evil.example"),
        ] {
            assert_eq!(socket(host, origin), Err(Refusal::ForeignOrigin), "{origin:?}");
        }
        let foreign = [("Host", host), ("Origin", "http://evil.example")];
        assert_eq!(checked("/", &foreign), Err(Refusal::ForeignOrigin));
        let plain = [("Host", host), ("Origin", "http://127.0.0.1:7180")];
        assert_eq!(checked("/socket", &plain), Err(Refusal::Malformed));
    }

    #[test]
    fn there_are_no_other_paths() {
        let host = [("Host", "127.0.0.1:7180")];
        for path in ["/../etc/passwd", "//", "/%2e%2e/", "/dashboard.js/..", "/keys", ""] {
            assert_eq!(checked(path, &host), Err(Refusal::NotFound), "{path}");
        }
        let address = SocketAddr::from(([127, 0, 0, 1], 7180));
        let head = Head { method: "POST", path: "/", headers: &host };
        assert_eq!(check(&head, address), Err(Refusal::Method));
    }

    #[test]
    fn a_token_is_all_of_itself() {
        let token = Token::generate().unwrap();
        assert_eq!(token.text().len(), 32);
        assert!(token.is(token.text()));
        for other in ["", &token.text()[1..], &format!("{}0", token.text()), "0"] {
            assert!(!token.is(other), "{other}");
        }
        assert_ne!(token.text(), Token::generate().unwrap().text());
    }
}
