//! Who may use the dashboard. Pure functions, so that every refusal has a test.

use std::net::{IpAddr, SocketAddr};

use wimu_host::Result;
use wimu_host::serve::{Method, Request, StatusCode, header};

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

/// What a page may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    None,
    Read,
    /// It has the token.
    Write,
}

/// What a request asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// A file of the page, by its index in [`FILES`].
    File(usize),
    /// A WebSocket.
    Socket,
}

/// Why a request is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// A required header is absent or repeated.
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
    /// Status of HTTP.
    pub fn status(self) -> StatusCode {
        match self {
            Self::Malformed => StatusCode::BAD_REQUEST,
            Self::ForeignHost | Self::ForeignOrigin => StatusCode::FORBIDDEN,
            Self::NotFound => StatusCode::NOT_FOUND,
            Self::Method => StatusCode::METHOD_NOT_ALLOWED,
        }
    }
}

/// Paths of the files, in the order in which the server holds them.
pub const FILES: [&str; 4] = ["/", "/style.css", "/plot.js", "/dashboard.js"];

/// The value of a header that is there once at most.
fn one<B>(
    request: &Request<B>,
    name: header::HeaderName,
) -> std::result::Result<Option<&str>, Refusal> {
    let mut values = request.headers().get_all(name).iter();
    let (first, second) = (values.next(), values.next());
    let text = first.map(|value| value.to_str()).transpose();
    text.ok().filter(|_| second.is_none()).ok_or(Refusal::Malformed)
}

/// Whether a request that was sent to `address` is answered.
///
/// `Host` must be an address or `localhost`, never another name, because a name can be rebound to this computer; and
/// loopback where the server is. A WebSocket needs an `Origin` that is this server, and any other request none that is
/// not.
///
/// # Errors
/// The reason of the refusal.
pub fn check<B>(request: &Request<B>, address: SocketAddr) -> std::result::Result<Target, Refusal> {
    let host = one(request, header::HOST)?.ok_or(Refusal::Malformed)?;
    if !is_ours(host, address) {
        return Err(Refusal::ForeignHost);
    }
    let origin = one(request, header::ORIGIN)?;
    let same = origin.map(|origin| origin.strip_prefix("http://") == Some(host));
    let path = request.uri().path();
    let target = match FILES.iter().position(|file| *file == path) {
        Some(file) => Target::File(file),
        None if path == "/socket" => Target::Socket,
        None => return Err(Refusal::NotFound),
    };
    if same == Some(false) || (target == Target::Socket && same.is_none()) {
        return Err(Refusal::ForeignOrigin);
    }
    if request.method() != Method::GET {
        return Err(Refusal::Method);
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

    fn asked(
        method: Method,
        path: &str,
        headers: &[(&str, &str)],
        address: [u8; 4],
    ) -> std::result::Result<Target, Refusal> {
        let mut request = Request::builder().method(method).uri(path);
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        check(&request.body(()).unwrap(), SocketAddr::from((address, 7180)))
    }

    fn checked(path: &str, headers: &[(&str, &str)]) -> std::result::Result<Target, Refusal> {
        asked(Method::GET, path, headers, [127, 0, 0, 1])
    }

    /// A request for the socket with this host and origin.
    fn socket(host: &str, origin: Option<&str>) -> std::result::Result<Target, Refusal> {
        let mut headers = vec![("Host", host)];
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
        let of = |host| asked(Method::GET, "/", &[("Host", host)], [0, 0, 0, 0]);
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
    }

    #[test]
    fn there_are_no_other_paths() {
        let host = [("Host", "127.0.0.1:7180")];
        for path in ["/../etc/passwd", "//", "/%2e%2e/", "/dashboard.js/..", "/keys"] {
            assert_eq!(checked(path, &host), Err(Refusal::NotFound), "{path}");
        }
        assert_eq!(asked(Method::POST, "/", &host, [127, 0, 0, 1]), Err(Refusal::Method));
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
