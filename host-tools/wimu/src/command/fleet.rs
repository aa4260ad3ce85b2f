//! `wimu fleet`.

use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use serde_json::json;
use wimu_host::calibration::parameter_id;
use wimu_host::fleet::rollout::{self, Plan};
use wimu_host::fleet::state::BoardState;
use wimu_host::fleet::status::{self, FleetStatus};
use wimu_host::fleet::topics::Fleet as Address;
use wimu_host::plural::counted;
use wimu_host::{Code, Result};

use crate::arguments::Fleet;
use crate::command::gateway;
use crate::output::Output;

/// Time to listen for the states before a push.
const LISTEN: std::time::Duration = std::time::Duration::from_secs(2);

pub fn run(action: &Fleet, output: &Output) -> Result<()> {
    match action {
        Fleet::Gateway(arguments) => gateway::run(arguments, output),
        Fleet::Status { fleet, seconds } => {
            let status = status::read(&fleet.parse()?, *seconds)?;
            show(&status, output);
            output.object(&status);
            Ok(())
        }
        Fleet::Push { fleet, folder, until, force } => {
            push(&fleet.parse()?, folder, *until, *force, output)
        }
    }
}

fn show(status: &FleetStatus, output: &Output) {
    let alive = status.alive().count();
    // Whoever may publish at the broker can forge them.
    let sum =
        |of: fn(&BoardState) -> u64| status.boards.values().map(of).fold(0, u64::saturating_add);
    let missing = sum(|state| state.missing);
    let unrecorded = match sum(|state| state.unrecorded_bytes) {
        0 => String::new(),
        bytes => format!("; {bytes} bytes not recorded"),
    };
    output.print(format!(
        "{alive} of {} alive; {missing} of {} samples missing{unrecorded}",
        counted(status.boards.len(), "board"),
        sum(|state| state.samples).saturating_add(missing)
    ));
    let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
    let width = status.boards.keys().map(String::len).fold(5, usize::max);
    if !status.boards.is_empty() {
        output.print(format!(
            "{:width$}  {:>9}  {:>11}  {:12}  {:>10}  {:>8}",
            "board", "last seen", "calibrated", "self-check", "samples", "missing"
        ));
    }
    for (name, state) in &status.boards {
        output.print(format!("{name:width$}  {}", row(state, now)));
    }
    if status.boards.is_empty() {
        output.print("no gateway has published a board of this fleet: check its name");
    }
    for topic in &status.unreadable {
        output.print(format!(
            "{topic:?}: the retained message is not a state; another program publishes there"
        ));
    }
}

fn row(state: &BoardState, now: f64) -> String {
    // Reports come every 30 s: a live board was seen since.
    let seen = match state.last_seen_utc_s {
        _ if state.alive => "now".to_owned(),
        Some(at) => age(now - at),
        None => "never".to_owned(),
    };
    let calibrated = match (state.calibrated_utc_s, state.parameter_id.as_deref()) {
        (Some(at), _) => age(now - at as f64),
        (None, None | Some("00000000")) => "no".to_owned(),
        (None, Some(_)) => "date unknown".to_owned(),
    };
    let check = match state.last_seen_utc_s {
        _ if state.contradicted => "contradicted",
        None if !state.alive => "–",
        _ => "ok",
    };
    let lost = state.lost.as_ref().map(|why| format!("  {why}")).unwrap_or_default();
    format!(
        "{seen:>9}  {calibrated:>11}  {check:12}  {:>10}  {:>8}{lost}",
        state.samples, state.missing
    )
}

/// A time in s as text.
fn age(seconds: f64) -> String {
    match seconds.max(0.0) {
        s if s < 120.0 => format!("{s:.0} s ago"),
        s if s < 7200.0 => format!("{:.0} min ago", s / 60.0),
        s if s < 172_800.0 => format!("{:.0} h ago", s / 3600.0),
        s => format!("{:.0} d ago", s / 86_400.0),
    }
}

fn push(fleet: &Address, folder: &Path, until: u8, force: bool, output: &Output) -> Result<()> {
    let status = status::read(fleet, LISTEN)?;
    let plan = Plan::new(&status, folder)?;
    for (what, names) in [
        ("without a file", &plan.without_file),
        ("away", &plan.away),
        ("files of no board", &plan.without_board),
    ] {
        if !names.is_empty() {
            output.print(format!("left out, {what}: {}", names.join(", ")));
        }
    }
    if plan.targets.is_empty() && !plan.away.is_empty() {
        let message = "all boards that have a file are away";
        let remedy = "`wimu fleet status` says why";
        return Err(Code::LinkAbsent.error(message, remedy));
    }
    if plan.targets.is_empty() {
        return Err(Code::DataRefused.error(
            format!("no board of fleet `{}` has a file in the folder", fleet.fleet),
            "name the files BOARD.json or DEVICE_ID.json; `wimu fleet status` lists the boards",
        ));
    }
    let targets = plan.targets.len();
    let boards = targets + plan.away.len();
    let (mut done, mut written) = (0, 0);
    for (stage, count) in (1..=until).zip(plan.stages()) {
        output.print(format!("stage {stage}: {count} of {}", counted(targets, "board")));
        for target in &plan.targets[done..count] {
            let pushed = rollout::push(fleet, target, force)?;
            let did = if pushed { "pushed, confirmed" } else { "held already" };
            let id = parameter_id(&target.set);
            output.print(format!("{}: {id} {did}", target.board));
            written += usize::from(pushed);
        }
        done = count;
    }
    output.print(format!(
        "boards with their calibration: {done} of {boards}; {written} written by this push"
    ));
    output.object(&json!({
        "boards": boards,
        "done": done,
        "written": written,
        "without_file": plan.without_file,
        "away": plan.away,
        "without_board": plan.without_board,
    }));
    Ok(())
}
