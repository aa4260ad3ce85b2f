//! Prometheus metrics over HTTP: `wimu_board_FIELD` for each number of a [`BoardState`](super::state::BoardState), and
//! `wimu_gateway_FIELD` for those of a [`GatewaySummary`].

use std::fmt::Write as _;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::Duration;

use serde::Serialize;
use serde_json::Value;

use super::gateway::{Boards, GatewaySummary, Shared};
use super::lock;
use crate::{ErrorCode, Result};

/// Longest request, and longest wait for it.
const MAX_REQUEST: usize = 4096;
const PATIENCE: Duration = Duration::from_secs(1);
/// Interval between looks at the stop flag.
const GLANCE: Duration = Duration::from_millis(100);

/// Opens the address.
///
/// # Errors
/// `link_busy`.
pub fn listen(address: SocketAddr) -> Result<TcpListener> {
    let listener = TcpListener::bind(address);
    let ready = listener.and_then(|listener| listener.set_nonblocking(true).map(|()| listener));
    ready.map_err(|error| {
        ErrorCode::LinkBusy
            .error(
                format!("cannot listen for Prometheus: {error}"),
                "stop the program that listens there, or change `metrics`",
            )
            .at(address.to_string())
    })
}

/// Answers requests until the gateway stops.
pub fn serve(listener: &TcpListener, shared: &Shared, boards: &Boards) {
    while !shared.stopped() {
        match listener.accept() {
            Ok((stream, _)) => {
                let _ = answer(stream, shared, boards);
            }
            Err(_) => std::thread::sleep(GLANCE),
        }
    }
}

fn answer(mut stream: TcpStream, shared: &Shared, boards: &Boards) -> std::io::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let mut request = Vec::new();
    let mut room = [0; 512];
    while request.len() < MAX_REQUEST && !request.windows(4).any(|end| end == b"\r\n\r\n") {
        match stream.read(&mut room)? {
            0 => return Ok(()),
            count => request.extend(&room[..count]),
        }
    }
    let (status, body) = match request.starts_with(b"GET /metrics ") {
        true => ("200 OK", text(shared, boards)),
        false => ("404 Not Found", "the metrics are at /metrics\n".to_owned()),
    };
    let length = body.len();
    write!(
        stream,
        "HTTP/1.1 {status}\r\nContent-Type: text/plain; version=0.0.4\r\nContent-Length: {length}\r\n\
         Connection: close\r\n\r\n{body}"
    )
}

/// All metrics, sorted by their names.
fn text(shared: &Shared, boards: &Boards) -> String {
    let mut lines = Vec::new();
    for (name, shown) in boards {
        let label = format!("{{board=\"{name}\"}}");
        add(&mut lines, "wimu_board", &label, &*lock(shown));
    }
    add(&mut lines, "wimu_gateway", "", &GatewaySummary::of(shared, boards));
    lines.sort();
    lines.concat()
}

fn add(lines: &mut Vec<String>, prefix: &str, label: &str, of: &impl Serialize) {
    let Ok(Value::Object(fields)) = serde_json::to_value(of) else {
        return;
    };
    for (field, value) in fields {
        let number = match value {
            Value::Number(number) => number.to_string(),
            Value::Bool(holds) => u8::from(holds).to_string(),
            _ => continue,
        };
        let mut line = String::new();
        let _ = writeln!(line, "{prefix}_{field}{label} {number}");
        lines.push(line);
    }
}
