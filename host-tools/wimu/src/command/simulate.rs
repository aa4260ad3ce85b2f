//! `wimu simulate`.

use std::path::Path;
use std::rc::Rc;
use std::sync::atomic::Ordering;

use serde::Serialize;
use serde_json::json;
use wimu_host::formats::{self, ReadOptions};
use wimu_host::recording::Selection;
use wimu_host::{Code, Problem, Result};
use wimu_link::LinkRole;
use wimu_model::Counts;
use wimu_sim::board::{Board, BoardConfig, SensorPart};
use wimu_sim::faults::{FaultCounts, LinkFaults, PRESETS, SensorFault};
use wimu_sim::motion::{self, Motion};
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

/// The true values of a link with faults, printed at the end.
#[derive(Serialize)]
struct LinkTruth {
    bias_m_s2: [f64; 3],
    scale: [f64; 3],
    noise_m_s2: f64,
    to_host: FaultCounts,
    to_device: FaultCounts,
}

/// A motion that is simulated; `None`: the samples of a file are replayed.
type Played = Option<(Scene, Rc<dyn Motion>)>;

pub fn run(arguments: &Simulate, output: &Output) -> Result<()> {
    let mut faults = Faults::of(&arguments.faults)?;
    let (part, _) = sensors(arguments)?;
    let (mut board, played) = board(arguments, &mut faults, output)?;
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
        let address = server.address(role);
        let address =
            address.map_err(|error| Problem::file("the listening port", "read", &error))?;
        Ok(format!("tcp://{address}"))
    };
    let (cable, wireless) = (url(LinkRole::Cable)?, url(LinkRole::Wireless)?);
    output.print(format!(
        "cable    {cable}\nwireless {wireless}\nCtrl-C stops it; in another terminal: wimu monitor {cable}"
    ));
    output.object(&json!({"cable": cable, "wireless": wireless}));
    let stop = interrupted()?;
    let clock_ppm = faults.clock_ppm;
    let mut course =
        Course { arguments, faults, part, played, pressed: 0, before_us: None, done_us: None };
    server.run(|board| course.step(board, output) || stop.load(Ordering::Relaxed));
    let [cable, wireless] =
        [LinkRole::Cable, LinkRole::Wireless].map(|role| truth(server.board(), role));
    for (name, link) in [("cable", &cable), ("wireless", &wireless)] {
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
    // The rate error of the board's clock is positive if it was fast.
    output.object(&json!({"clock_ppm": clock_ppm, "cable": cable, "wireless": wireless}));
    Ok(())
}

/// The board with its sensors in motion, or with the samples of a file.
fn board(arguments: &Simulate, faults: &mut Faults, output: &Output) -> Result<(Board, Played)> {
    let [cable_faults, wireless_faults] = std::mem::take(&mut faults.links);
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
    if let Some(path) = &arguments.replay {
        let counts = counts_of(arguments, path)?;
        output.print(format!("replaying {} samples of {}", counts.len(), path.display()));
        return Ok((Board::start(config, Replay::new(counts).waiting_for_reader()), None));
    }
    let scene = Scene::new(World::default());
    let motion = motion::named(&arguments.motion, arguments.seed).map_err(|unknown| {
        let known: Vec<_> = motion::NAMES.iter().map(|(name, _)| *name).collect();
        usage(unknown.to_string(), format!("choose from {}", known.join(", ")))
    })?;
    scene.play(0.0, motion.clone());
    let truth = part.random_truth(arguments.seed, Gauge::LowerTriangular);
    let physics = Physics::new(truth, scene.clone(), arguments.seed);
    let Some(second) = second else {
        return Ok((Board::start(config, physics), Some((scene, motion))));
    };
    // Errors and noise of its own.
    let seed = arguments.seed.wrapping_add(SECOND_SEED);
    let other = Physics::new(second.random_truth(seed, Gauge::Full), scene.clone(), seed);
    Ok((Board::start_pair(config, physics, (second, other)), Some((scene, motion))))
}

/// What happens to the board while it runs.
struct Course<'a> {
    arguments: &'a Simulate,
    faults: Faults,
    part: SensorPart,
    played: Played,
    /// Presses of the button so far.
    pressed: u16,
    before_us: Option<u64>,
    done_us: Option<u64>,
}

impl Course<'_> {
    /// Applies faults, presses and the motion; returns whether the simulation is over.
    fn step(&mut self, board: &mut Board, output: &Output) -> bool {
        let now_us = board.now_us();
        let now_s = now_us as f64 * 1e-6;
        for fault in &self.faults.sensor {
            fault.apply(self.part, board.sensor(), self.before_us, now_us);
        }
        self.before_us = Some(now_us);
        let presses_s = &self.faults.presses_s;
        while presses_s.get(usize::from(self.pressed)).is_some_and(|at_s| *at_s <= now_s) {
            self.pressed += 1;
            board.press(self.pressed);
        }
        let exits = self.arguments.exit_when_done;
        let done = match &self.played {
            Some((scene, motion)) => {
                let over = now_s >= scene.end_s();
                if over && !exits {
                    scene.play(scene.end_s(), motion.clone());
                }
                over
            }
            None => board.sensor().finished(),
        };
        if done && self.done_us.is_none() {
            self.done_us = Some(now_us);
            output.print(match (&self.played, exits) {
                (Some(_), false) => "the motion starts again",
                (Some(_), true) => "the motion is over",
                (None, _) => "the replayed file is over; the sensor has no more data",
            });
        }
        exits && self.done_us.is_some_and(|at| now_us >= at + LINGER_US)
    }
}

fn truth(board: &Board, role: LinkRole) -> Option<LinkTruth> {
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
                let message = format!("--faults: `{fault}` is not a fault");
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
