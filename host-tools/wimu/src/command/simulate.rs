//! `wimu simulate`.

use std::path::Path;
use std::sync::atomic::Ordering;

use serde::Serialize;
use wimu_host::formats::{self, ReadOptions};
use wimu_host::recording::Selection;
use wimu_host::{Code, Problem, Result};
use wimu_link::LinkRole;
use wimu_model::Counts;
use wimu_sim::board::{Board, BoardConfig, SensorPart};
use wimu_sim::faults::{FaultCounts, LinkFaults, PRESETS, SensorFault};
use wimu_sim::motion;
use wimu_sim::pipe::LinkConfig;
use wimu_sim::scene::{Scene, World};
use wimu_sim::server::Server;
use wimu_sim::source::{Physics, Replay};
use wimu_sim::storage::Storage;
use wimu_sim::truth::Gauge;

use crate::arguments::Simulate;
use crate::command::interrupted;
use crate::output::{Output, usage};

/// Time to deliver the last batches after the end of the motion, µs.
const LINGER_US: u64 = 2_000_000;
/// Added to the seed for the second sensor.
const SECOND_SEED: u64 = 0x5EC0;
/// Device time in which the board erases a lost key, µs: above the longest pause of its store.
const ERASE_US: u64 = 1_000_000;

#[derive(Serialize)]
struct Listening {
    cable: String,
    wireless: String,
}

/// The true values of the simulation, printed at its end.
#[derive(Serialize)]
struct Truth {
    /// Rate error of the board's clock, positive if it was fast.
    clock_ppm: f64,
    cable: Option<LinkTruth>,
    wireless: Option<LinkTruth>,
}

/// Statistics of a link with faults.
#[derive(Serialize)]
struct LinkTruth {
    bias_m_s2: [f64; 3],
    scale: [f64; 3],
    noise_m_s2: f64,
    to_host: FaultCounts,
    to_device: FaultCounts,
}

pub fn run(arguments: &Simulate, output: &Output) -> Result<()> {
    let faults = Faults::of(&arguments.faults)?;
    let [cable_faults, wireless_faults] = faults.links;
    let storage = match &arguments.store {
        Some(path) => Storage::in_file(path)
            .map_err(|error| Problem::file(&path.display().to_string(), "read", &error))?,
        None => Storage::in_memory(),
    };
    let (part, second) = sensors(arguments)?;
    let config = BoardConfig {
        // TCP has no baud rate; a slow client makes the board shed telemetry.
        cable: LinkConfig::default(),
        wireless: LinkConfig::default(),
        cable_faults,
        wireless_faults,
        fault_seed: arguments.seed,
        clock_error_ppb: (faults.clock_ppm * 1e3).round() as i32,
        storage,
        sensor: part,
        replay: arguments.replay.is_some(),
        device_id: 0x5157_0000_u64.wrapping_add(arguments.seed),
    };
    let (mut board, played) = match &arguments.replay {
        Some(path) => {
            let counts = counts_of(arguments, path)?;
            output.print(format!("replaying {} samples of {}", counts.len(), path.display()));
            (Board::start(config, Replay::new(counts).waiting_for_reader()), None)
        }
        None => {
            let scene = Scene::new(World::default());
            let motion = motion::named(&arguments.motion, arguments.seed).map_err(|unknown| {
                let known: Vec<_> = motion::NAMES.iter().map(|(name, _)| *name).collect();
                usage(unknown.to_string(), format!("choose from {}", known.join(", ")))
            })?;
            scene.play(0.0, motion.clone());
            let truth = part.random_truth(arguments.seed, Gauge::LowerTriangular);
            let physics = Physics::new(truth, scene.clone(), arguments.seed);
            let board = match second {
                Some(second) => {
                    // Errors and noise of its own.
                    let seed = arguments.seed.wrapping_add(SECOND_SEED);
                    let truth = second.random_truth(seed, Gauge::Full);
                    let other = Physics::new(truth, scene.clone(), seed);
                    Board::start_pair(config, physics, (second, other))
                }
                None => Board::start(config, physics),
            };
            (board, Some((scene, motion)))
        }
    };
    if arguments.forget_key {
        board.forget_key();
        // The erase is complete before a client connects.
        board.run_until(board.now_us() + ERASE_US);
    }
    let mut server = Server::bind(board, arguments.cable, arguments.wireless)
        .map_err(|(address, error)| {
            Code::LinkBusy.error(format!("cannot listen: {error}"),
                "stop the program that listens there, or give other addresses with --cable and --wireless",
            )
            .at(address.to_string())
        })?
        .at_speed(arguments.speed);
    if arguments.replay.is_some() || arguments.exit_when_done {
        server = server.waiting_for_client();
    }
    let url = |role| {
        server
            .address(role)
            .map(|address| format!("tcp://{address}"))
            .map_err(|error| Problem::file("the listening port", "read", &error))
    };
    let listening = Listening { cable: url(LinkRole::Cable)?, wireless: url(LinkRole::Wireless)? };
    output.print(format!(
        "cable    {}\nwireless {}\nCtrl-C stops it; in another terminal: wimu monitor {}",
        listening.cable, listening.wireless, listening.cable
    ));
    output.object(&listening);
    let stop = interrupted()?;
    let mut done_at = None;
    let mut presses = (1..).zip(faults.presses_s).peekable();
    let mut before_us = None;
    server.run(|board| {
        let now_us = board.now_us();
        for fault in &faults.sensor {
            fault.apply(part, board.sensor(), before_us, now_us);
        }
        before_us = Some(now_us);
        let is_due = |(_, at_s): &(u16, f64)| *at_s <= now_us as f64 * 1e-6;
        while let Some((count, _)) = presses.next_if(is_due) {
            board.press(count);
        }
        let done = match &played {
            Some((scene, motion)) => {
                let over = now_us as f64 * 1e-6 >= scene.end_s();
                if over && !arguments.exit_when_done {
                    scene.play(scene.end_s(), motion.clone());
                }
                over
            }
            None => board.sensor().finished(),
        };
        if done && done_at.is_none() {
            done_at = Some(now_us);
            output.print(match (&played, arguments.exit_when_done) {
                (Some(_), false) => "the motion starts again",
                (Some(_), true) => "the motion is over",
                (None, _) => "the replayed file is over; the sensor has no more data",
            });
        }
        stop.load(Ordering::Relaxed)
            || (arguments.exit_when_done && done_at.is_some_and(|at| now_us >= at + LINGER_US))
    });
    let board = server.board();
    let truth = |role| {
        let channels = board.faults(role)?;
        let to_host = channels.to_host.borrow();
        let values = to_host.faults().values.unwrap_or_default();
        Some(LinkTruth {
            bias_m_s2: values.bias_mps2,
            scale: values.scale,
            noise_m_s2: values.noise_mps2,
            to_host: to_host.counts(),
            to_device: channels.to_device.borrow().counts(),
        })
    };
    let truth = Truth {
        clock_ppm: faults.clock_ppm,
        cable: truth(LinkRole::Cable),
        wireless: truth(LinkRole::Wireless),
    };
    for (name, link) in [("cable", &truth.cable), ("wireless", &truth.wireless)] {
        if let Some(LinkTruth { to_host, .. }) = link {
            output.print(format!(
                "{name}: {} bytes sent, {} lost, {} bits flipped; frames: {} intact, {} damaged, {} lost",
                to_host.bytes_sent,
                to_host.bytes_lost + to_host.bytes_overflowed + to_host.bytes_disconnected,
                to_host.bits_flipped,
                to_host.frames_intact,
                to_host.frames_damaged + to_host.frames_fused,
                to_host.frames_lost,
            ));
        }
    }
    output.object(&truth);
    Ok(())
}

/// The sensor, and a second one.
fn sensors(arguments: &Simulate) -> Result<(SensorPart, Option<SensorPart>)> {
    use SensorPart::{Adxl345, Lsm303agr};
    let parts: Vec<SensorPart> = arguments.chip.iter().map(|chip| (*chip).into()).collect();
    match parts[..] {
        [part] => Ok((part, None)),
        [first @ Lsm303agr, second @ Adxl345] | [first @ Adxl345, second @ Lsm303agr] => {
            match arguments.replay {
                None => Ok((first, Some(second))),
                Some(_) => Err(usage("--replay replays one sensor", "give one --chip")),
            }
        }
        _ => Err(usage(
            "--chip: these sensors are not simulated on one board",
            "give one, or lsm303agr,adxl345",
        )),
    }
}

/// Everything that `--faults` names.
#[derive(Default)]
struct Faults {
    /// Of the cable and of the wireless link.
    links: [LinkFaults; 2],
    sensor: Vec<SensorFault>,
    clock_ppm: f64,
    /// Times at which the button is pressed, s, in order.
    presses_s: Vec<f64>,
}

impl Faults {
    fn of(specs: &[String]) -> Result<Self> {
        let mut faults = Self::default();
        let mut texts = [Vec::new(), Vec::new()];
        for spec in specs {
            // A link prefix holds until the next one.
            let mut link = 1;
            for part in spec.split(',').map(str::trim) {
                let prefixed =
                    ["cable:", "wireless:"].iter().position(|name| part.starts_with(name));
                link = prefixed.unwrap_or(link);
                let fault = match prefixed {
                    Some(_) => part.split_once(':').map_or(part, |(_, fault)| fault),
                    None => part,
                };
                if !faults.take(fault)? {
                    texts[link].push(fault);
                }
            }
        }
        faults.links = [of_link(&texts[0])?, of_link(&texts[1])?];
        faults.presses_s.sort_by(f64::total_cmp);
        Ok(faults)
    }

    /// Takes a fault of the board itself; returns whether it is one.
    fn take(&mut self, fault: &str) -> Result<bool> {
        let number = |text: &str, unit: &str, least: f64, most: f64| {
            let value = text.strip_suffix(unit).and_then(|text| text.parse().ok());
            value.filter(|value| (least..=most).contains(value)).ok_or_else(|| {
                let message = format!("--faults: `{fault}` is no fault");
                usage(message, format!("give a number from {least} to {most} with the unit {unit}"))
            })
        };
        match fault.split_once('=') {
            Some(("clock", text)) => self.clock_ppm = number(text, "ppm", -1e4, 1e4)?,
            Some(("press", text)) => self.presses_s.push(number(text, "s", 0.0, 1e9)?),
            _ => match fault.parse() {
                Ok(fault) => self.sensor.push(fault),
                Err(_) => return Ok(false),
            },
        }
        Ok(true)
    }
}

fn of_link(texts: &[&str]) -> Result<LinkFaults> {
    texts.join(",").parse().map_err(|error| {
        let presets: Vec<_> = PRESETS.iter().map(|(name, ..)| *name).collect();
        usage(
            format!("--faults: {error}"),
            format!(
                "give presets ({}) or faults such as loss=2%,bits=1e-4,jitter=50ms,stall=3s@30s; see `wimu simulate --help`",
                presets.join(", ")
            ),
        )
    })
}

/// Raw counts of a CSV file in LSB.
fn counts_of(arguments: &Simulate, path: &Path) -> Result<Vec<Counts>> {
    let mut load = ReadOptions::default();
    load.filter = arguments.filter.clone();
    let selection = Selection { accelerometer: arguments.sensor, poses: false };
    formats::load(path, &load)?.samples(selection)?.counts()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_link_prefix_holds_until_the_next_one() {
        let of = |specs: &[&str]| {
            let specs: Vec<_> = specs.iter().map(|spec| (*spec).to_owned()).collect();
            Faults::of(&specs).unwrap().links
        };
        let expected = of(&["latency=20ms,loss=2%", "cable:latency=2ms,bits=1e-5"]);
        assert_ne!(expected[0], expected[1]);
        for specs in [
            &["wireless:latency=20ms,wireless:loss=2%,cable:latency=2ms,bits=1e-5"][..],
            &["cable:latency=2ms, cable:bits=1e-5, wireless:latency=20ms, loss=2%"],
            &["latency=20ms,loss=2%,cable:latency=2ms,cable:bits=1e-5"],
        ] {
            assert_eq!(of(specs), expected, "{specs:?}");
        }
        assert!(Faults::of(&["usb:latency=2ms".to_owned()]).is_err());
    }
}
