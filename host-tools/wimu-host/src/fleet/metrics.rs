//! Prometheus metrics over HTTP: `wimu_board_FIELD` for each number of a [`BoardState`](super::state::BoardState), and
//! `wimu_gateway_FIELD` for those of a [`GatewaySummary`].

use std::fmt::Write as _;
use std::net::SocketAddr;
use std::sync::Arc;

use serde::Serialize;
use serde_json::Value;

use super::gateway::{Boards, GatewaySummary, Shared};
use super::lock;
use crate::Result;
use crate::serve::{Server, StatusCode, respond};

/// Serves them at an address until the server is dropped.
///
/// # Errors
/// `link_busy`.
pub fn serve(address: SocketAddr, shared: Arc<Shared>, boards: Arc<Boards>) -> Result<Server> {
    let remedy = "stop the program that listens there, or change `metrics`";
    Server::start(address, remedy, move |request, _| match request.uri().path() {
        "/metrics" => respond(StatusCode::OK, "text/plain; version=0.0.4", text(&shared, &boards)),
        _ => respond(StatusCode::NOT_FOUND, "text/plain", "the metrics are at /metrics\n"),
    })
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
