//! The server of the page: four files, and a WebSocket for each page.

use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use tungstenite::handshake::derive_accept_key;
use tungstenite::protocol::{CloseFrame, Role, WebSocketConfig, frame::coding::CloseCode};
use tungstenite::{Error, Message, WebSocket};
use wimu_host::html;
use wimu_host::{ErrorCode, Result};

use super::access::{Head, Refusal, Target, check};
use super::hub::{Hub, Page};

/// Longest wait for messages to a page before those of the page are read.
const GLANCE: Duration = Duration::from_millis(10);
/// Longest time until the head of a request is complete, and in which a page takes nothing.
const PATIENCE: Duration = Duration::from_secs(10);
const MOST_HEAD: usize = 8192;
const MOST_CONNECTIONS: usize = 32;
/// Largest message of a page, and of what waits for it in the socket, bytes.
const MOST_MESSAGE: usize = 1 << 16;
const MOST_WAITING: usize = 16 << 20;

const SCRIPT: &str = include_str!("page/dashboard.js");
const PAGE: &str = include_str!("page/index.html");
const STYLE: &str = include_str!("page/style.css");

/// What the page may load: its own files and its socket, nothing of elsewhere.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; \
    connect-src 'self'; img-src 'self' data: blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Answers the messages of pages.
pub trait Answers: Send + Sync {
    /// Takes a message; returns false if the page has to go.
    fn take(&self, page: &Arc<Page>, message: &str) -> bool;
}

/// A server that listens.
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
}

impl Server {
    /// # Errors
    /// `link_busy` when the address is in use.
    pub fn bind(address: SocketAddr) -> Result<Self> {
        let failed = |error: std::io::Error| {
            let message = format!("cannot listen: {error}");
            let remedy = "give another port with --port, or in --listen; 0 is a free one";
            ErrorCode::LinkBusy.error(message, remedy).at(address.to_string())
        };
        let listener = TcpListener::bind(address).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        Ok(Self { listener, address })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Answers in threads of its own until the process ends.
    pub fn run(self, hub: Arc<Hub>, answers: Arc<dyn Answers>) {
        let connections = Arc::new(AtomicUsize::new(0));
        thread::spawn(move || {
            for stream in self.listener.incoming() {
                let Ok(stream) = stream else {
                    // Out of file descriptors: others may end.
                    thread::sleep(GLANCE);
                    continue;
                };
                if connections.fetch_add(1, Ordering::Relaxed) >= MOST_CONNECTIONS {
                    connections.fetch_sub(1, Ordering::Relaxed);
                    continue;
                }
                let (hub, answers) = (hub.clone(), answers.clone());
                let (connections, address) = (connections.clone(), self.address);
                thread::spawn(move || {
                    // A browser that closes a connection is no failure.
                    let _ = serve(stream, address, &hub, &*answers);
                    connections.fetch_sub(1, Ordering::Relaxed);
                });
            }
        });
    }
}

/// Answers one request. A connection is for one: the page has four files.
fn serve(
    mut stream: TcpStream,
    address: SocketAddr,
    hub: &Hub,
    answers: &dyn Answers,
) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let head = read_head(&mut stream)?;
    let mut headers = [httparse::EMPTY_HEADER; 64];
    let mut request = httparse::Request::new(&mut headers);
    let parsed = request.parse(&head).is_ok_and(|status| status.is_complete());
    let texts: Option<Vec<(&str, &str)>> = (request.headers.iter())
        .map(|header| Some((header.name, std::str::from_utf8(header.value).ok()?)))
        .collect();
    let head = texts.as_deref().filter(|_| parsed).map(|headers| Head {
        method: request.method.unwrap_or_default(),
        path: request.path.unwrap_or_default(),
        headers,
    });
    let target = head.as_ref().ok_or(Refusal::Malformed);
    match target.and_then(|head| Ok((check(head, address)?, head))) {
        Err(refusal) => respond(&mut stream, refusal.status(), "text/plain", refusal.status()),
        Ok((Target::File(file), _)) => {
            let javascript = "text/javascript; charset=utf-8";
            let css = format!("{}\n{STYLE}", html::STYLE);
            let (kind, text) = [
                ("text/html; charset=utf-8", PAGE),
                ("text/css; charset=utf-8", css.as_str()),
                (javascript, html::PLOT_SCRIPT),
                (javascript, SCRIPT),
            ][file];
            respond(&mut stream, "200 OK", kind, text)
        }
        Ok((Target::Socket, head)) => {
            let key = head.socket_key().unwrap_or_default();
            let accept = derive_accept_key(key.as_bytes());
            write!(
                stream,
                "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
                 Sec-WebSocket-Accept: {accept}\r\n\r\n"
            )?;
            stream.set_nonblocking(true)?;
            let config = WebSocketConfig::default()
                .max_message_size(Some(MOST_MESSAGE))
                .max_frame_size(Some(MOST_MESSAGE))
                .write_buffer_size(0)
                .max_write_buffer_size(MOST_WAITING);
            let socket = WebSocket::from_raw_socket(stream, Role::Server, Some(config));
            let page = Arc::new(Page::default());
            talk(socket, &page, hub, answers);
            hub.leave(&page);
            Ok(())
        }
    }
}

fn read_head(stream: &mut TcpStream) -> std::io::Result<Vec<u8>> {
    let end = Instant::now() + PATIENCE;
    let mut head = Vec::new();
    let mut buffer = [0; 1024];
    while !head.ends_with(b"\r\n\r\n") {
        let left = end.saturating_duration_since(Instant::now());
        if left.is_zero() || head.len() > MOST_HEAD {
            return Err(ErrorKind::TimedOut.into());
        }
        stream.set_read_timeout(Some(left))?;
        match stream.read(&mut buffer)? {
            0 => return Err(ErrorKind::UnexpectedEof.into()),
            count => head.extend(&buffer[..count]),
        }
    }
    Ok(head)
}

fn respond(stream: &mut TcpStream, status: &str, kind: &str, text: &str) -> std::io::Result<()> {
    write!(
        stream,
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nContent-Security-Policy: {POLICY}\r\n\
         X-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\nCross-Origin-Resource-Policy: same-origin\r\n\
         Cache-Control: no-store\r\nConnection: close\r\n\r\n{text}",
        text.len()
    )
}

/// Exchanges messages with a page until either end closes.
fn talk(mut socket: WebSocket<TcpStream>, page: &Arc<Page>, hub: &Hub, answers: &dyn Answers) {
    let mut taken = Instant::now();
    loop {
        let idle = match socket.flush() {
            Ok(()) => true,
            Err(error) if would_block(&error) => false,
            Err(_) => return,
        };
        // What it does not take yet stays in its queue, where the oldest frames make room.
        if idle {
            taken = Instant::now();
            for text in hub.take(page, GLANCE) {
                match socket.write(Message::text(&*text)) {
                    Ok(()) => {}
                    Err(error) if would_block(&error) => {}
                    Err(_) => return,
                }
            }
        } else if taken.elapsed() > PATIENCE {
            return;
        } else {
            thread::sleep(GLANCE);
        }
        loop {
            match socket.read() {
                Ok(Message::Text(text)) => {
                    if !answers.take(page, text.as_str()) {
                        let reason = "the token is wrong or missing".into();
                        let code = CloseCode::Policy;
                        let _ = socket.close(Some(CloseFrame { code, reason }));
                        let _ = socket.flush();
                        return;
                    }
                }
                Ok(_) => {}
                Err(error) if would_block(&error) => break,
                Err(_) => return,
            }
        }
    }
}

fn would_block(error: &Error) -> bool {
    matches!(error, Error::Io(error) if error.kind() == ErrorKind::WouldBlock)
}
