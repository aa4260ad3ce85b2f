//! `wimu fleet gateway`.

use std::time::{Duration, Instant};

use serde_json::json;
use wimu_host::Result;
use wimu_host::fleet::config::GatewayConfig;
use wimu_host::fleet::gateway::{Gateway, GatewaySummary};
use wimu_host::plural::counted;

use crate::arguments::Gateway as Arguments;
use crate::command::{deadline, interrupted, is_over};
use crate::output::Output;

/// Interval of the lines of figures.
const EVERY: Duration = Duration::from_secs(10);

pub fn run(arguments: &Arguments, output: &Output) -> Result<()> {
    let config = GatewayConfig::read(&arguments.config)?;
    let end = deadline(arguments.seconds);
    let stop = interrupted()?;
    let head = format!(
        "gateway `{}` of fleet `{}`: {} to {}; Ctrl-C stops",
        config.gateway,
        config.fleet,
        counted(config.boards.len(), "board"),
        config.broker
    );
    let boards = config.boards.len();
    let gateway = Gateway::start(config)?;
    let metrics = gateway.metrics();
    output.print(head);
    if let Some(address) = metrics {
        output.print(format!("metrics at http://{address}/metrics"));
    }
    output.object(&json!({"boards": boards, "metrics": metrics}));
    let mut shown = Instant::now();
    while !is_over(end, &stop) {
        std::thread::sleep(Duration::from_millis(50));
        gateway.notes().for_each(|note| output.print(note));
        if shown.elapsed() >= EVERY {
            shown = Instant::now();
            output.print(line(&gateway.summary()));
        }
    }
    let summary = gateway.stop();
    output.print(format!("stopped: {}", line(&summary)));
    output.object(&summary);
    Ok(())
}

fn line(sum: &GatewaySummary) -> String {
    let broker = if sum.mqtt.broker { "" } else { ", BROKER AWAY" };
    let dropped = match sum.mqtt.dropped {
        0 => String::new(),
        count => format!(", {count} batches dropped"),
    };
    let unrecorded = match sum.unrecorded_bytes {
        0 => String::new(),
        count => format!(", {count} bytes not recorded"),
    };
    format!(
        "{} of {} boards, {} samples, {} missing, {} batches published, {} waiting{dropped}{unrecorded}{broker}",
        sum.alive, sum.boards, sum.samples, sum.missing, sum.mqtt.published, sum.mqtt.waiting
    )
}
