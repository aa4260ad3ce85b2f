//! `wimu navigate LINK_A LINK_B --relative`.

use std::sync::mpsc::{self, Sender};
use std::thread;

use serde_json::{Value, json};
use wimu_host::decode::{Arrival, Event};
use wimu_host::imu::{self, Imu};
use wimu_host::monitor::Readings;
use wimu_host::relative::{Body, LiveRelative, RelativeChoice, RelativePoint};
use wimu_host::{Code, LinkUrl, Problem, Result};

use super::super::live::sample;
use super::super::shown::{Shown, WAIT, corrected_there, writable};
use super::present;
use crate::arguments::Navigate;
use crate::command::{Connection, connect, interrupted, listen_until};
use crate::output::{Output, usage};

/// A rotation, as `--json` prints it: time by the clock of the first unit, W, X, Y, Z from the axes of B to those of A.
fn object(point: &RelativePoint, accurate: bool) -> Value {
    json!({
        "time_s": point.time_s,
        "angle_deg": point.angle_rad.to_degrees(),
        "sigma_deg": point.sigma_rad.to_degrees(),
        "quaternion": point.quaternion,
        "attitude_sigma_deg": point.attitude_sd_rad.map(f64::to_degrees),
        "accurate": accurate,
        "valid": point.valid,
    })
}

fn line(point: &RelativePoint, accurate: bool) -> String {
    let note = match (point.valid, accurate) {
        (false, _) => "  not valid: a unit is silent",
        (true, false) => "  not accurate yet: move the joint through its range",
        _ => "",
    };
    let [angle, sigma] = [point.angle_rad, point.sigma_rad].map(f64::to_degrees);
    format!("{:8.2} s  {angle:+.1}° ± {sigma:.1}°{note}", point.time_s)
}

/// What a unit sends.
enum Message {
    Sample { time_s: f64, arrived_s: f64, sample: imu::Sample },
    Restart,
    Ended(Problem),
}

/// Prints the angle between two boards while they move.
pub fn run(
    arguments: &Navigate,
    links: [LinkUrl; 2],
    choice: RelativeChoice,
    output: &Output,
) -> Result<()> {
    let names = links.map(|link| link.to_string());
    corrected_there(arguments, &names[0])?;
    writable(arguments)?;
    let clients = [connect(&names[0])?, connect(&names[1])?];
    if clients[0].hello().device_id == clients[1].hello().device_id {
        let remedy = "give a LINK of each of two boards";
        return Err(usage("both LINKs are of one board", remedy));
    }
    // Before the threads, which share its flag.
    interrupted()?;
    let begin = || {
        let of = |name: &String| Imu::new(name);
        LiveRelative::new(choice, names.each_ref().map(of))
    };
    let (mut live, mut points, mut ended) = (begin(), Vec::new(), Ok(()));
    let mut shown = Shown::new(arguments.updates, output);
    thread::scope(|scope| {
        let (send, received) = mpsc::channel();
        for (body, client) in [Body::A, Body::B].into_iter().zip(clients) {
            let send = send.clone();
            scope.spawn(move || listen(arguments, client, body, &send));
        }
        drop(send);
        for (body, message) in received {
            match message {
                Message::Sample { time_s, arrived_s, sample } => {
                    live.push(body, time_s, arrived_s, sample)
                }
                Message::Restart => {
                    output.print(format!(
                        "{} has restarted: move the joint again",
                        names[body as usize]
                    ));
                    live = begin();
                }
                Message::Ended(error) => {
                    ended = Err(error);
                    break;
                }
            }
            for point in live.take() {
                if shown.is_due(point.time_s) {
                    let accurate = live.is_accurate();
                    let object = object(&point, accurate);
                    shown.show(point.time_s, &object, || line(&point, accurate));
                    points.push(point);
                }
            }
            shown.say(&live.findings());
            if !shown.going {
                break;
            }
        }
    });
    output.end_refresh();
    let Some(path) = live.path(points) else {
        ended?;
        let message =
            "no angle within the time: the first needs eight seconds of motion of the joint";
        return Err(live
            .lacks()
            .cloned()
            .unwrap_or_else(|| Code::NoRows.error(message, WAIT).at(names.join(" and "))));
    };
    present(arguments, names, path, output)?;
    ended
}

/// Passes on what a unit sends, until the time is over, Ctrl-C, or nobody receives.
fn listen(
    arguments: &Navigate,
    mut client: Connection,
    body: Body,
    send: &Sender<(Body, Message)>,
) {
    let mut readings = Readings::new();
    let heard = |arrival: &Arrival| {
        let mut messages = Vec::new();
        if let Event::Restart { .. } = arrival.event {
            readings = Readings::new();
            messages.push(Message::Restart);
        }
        readings.push(&arrival.event, |reading| {
            messages.push(Message::Sample {
                time_s: reading.time.to_seconds(),
                arrived_s: arrival.host_ns as f64 * 1e-9,
                sample: sample(&reading),
            });
        });
        Ok(messages.into_iter().all(|message| send.send((body, message)).is_ok()))
    };
    if let Err(error) = listen_until(&mut client, arguments.seconds, heard) {
        // Nobody receives it where the other unit has ended first.
        let _ = send.send((body, Message::Ended(error)));
    }
}
