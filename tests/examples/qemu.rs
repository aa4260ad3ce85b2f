//! The firmware of `firmware/qemu-mps2` in QEMU in real time, with a sensor that moves: `cargo
//! xtask qemu` builds the firmware and runs this.

#[cfg(unix)]
mod running {
    use std::net::{SocketAddr, TcpListener};
    use std::path::Path;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};

    use wimu_host::{Code, Problem, Result};
    use wimu_sim::board::SensorPart;
    use wimu_sim::motion;
    use wimu_sim::scene::{Scene, World};
    use wimu_sim::source::Physics;
    use wimu_sim::truth::Gauge;
    use wimu_tests::qemu::{FreeRunning, Machine};

    const USAGE: &str = "\
Usage: qemu IMAGE [OPTION VALUE]…

  --memory FILE        where the board keeps parameters and settings; without it, it forgets
  --log FILE           where its defmt log goes (default IMAGE.log); read it with
                       `defmt-print -e IMAGE < FILE`
  --sensor NAME        the board's sensor: lsm303agr (default) or lsm6dso
  --motion NAMES       what moves the sensor (default twelve-poses,slide): rest, six-positions,
                       twelve-poses, tilts, slide, carry, hand
  --seed N             the sensor's errors and noise (default 1)
  --cable ADDRESS      where the cable listens (default 127.0.0.1:7100)
  --wireless ADDRESS   where the wireless link listens (default 127.0.0.1:7101)";

    struct Options {
        machine: Machine,
        motion: String,
        seed: u64,
        cable: SocketAddr,
        wireless: SocketAddr,
    }

    pub fn run() -> Result<()> {
        let words: Vec<String> = std::env::args().skip(1).collect();
        if words.iter().any(|word| word == "--help") {
            println!("{USAGE}");
            return Ok(());
        }
        let options = parse(&words)?;
        if options.cable == options.wireless {
            return Err(usage("the cable and the wireless link need an address each"));
        }
        for address in [options.cable, options.wireless] {
            is_free(address)?;
        }
        let scene = Scene::new(World::default());
        let motion = motion::named(&options.motion, options.seed)
            .map_err(|unknown| usage(unknown.to_string()))?;
        scene.play(1.0, motion);
        let part = options.machine.sensor;
        let truth = part.random_truth(options.seed, Gauge::LowerTriangular);
        let source = Physics::new(truth, scene, options.seed);
        let stop = Arc::new(AtomicBool::new(false));
        let set = stop.clone();
        ctrlc::set_handler(move || set.store(true, Ordering::Relaxed))
            .map_err(|error| usage(format!("Ctrl-C cannot be caught: {error}")))?;
        let Options { machine, cable, wireless, .. } = &options;
        let mut board = FreeRunning::start(machine, source, *cable, *wireless)?;
        println!(
            "cable    tcp://{cable}\nwireless tcp://{wireless}\n\
             Ctrl-C stops; in another terminal: cargo wimu monitor tcp://{cable}"
        );
        board.run(|| stop.load(Ordering::Relaxed))
    }

    fn parse(words: &[String]) -> Result<Options> {
        let [image, options @ ..] = words else {
            return Err(usage("no IMAGE given"));
        };
        let mut parsed = Options {
            machine: Machine {
                log: Some(Path::new(image).with_extension("log")),
                ..Machine::new(Path::new(image), SensorPart::Lsm303agr)
            },
            motion: "twelve-poses,slide".into(),
            seed: 1,
            cable: ([127, 0, 0, 1], 7100).into(),
            wireless: ([127, 0, 0, 1], 7101).into(),
        };
        for pair in options.chunks(2) {
            let [name, value] = pair else {
                return Err(usage(format!("{} needs a value", pair[0])));
            };
            let wrong = |_| usage(format!("{name} {value} is not understood"));
            match name.as_str() {
                "--memory" => parsed.machine.memory = Some(value.into()),
                "--sensor" if value == "lsm303agr" => {}
                "--sensor" if value == "lsm6dso" => {
                    let with_sensor = Machine::new(Path::new(image), SensorPart::Lsm6dso);
                    (parsed.machine.image, parsed.machine.sensor) =
                        (with_sensor.image, with_sensor.sensor);
                }
                "--log" => parsed.machine.log = Some(value.into()),
                "--motion" => parsed.motion.clone_from(value),
                "--seed" => parsed.seed = value.parse().map_err(|_| wrong(()))?,
                "--cable" => parsed.cable = value.parse().map_err(|_| wrong(()))?,
                "--wireless" => parsed.wireless = value.parse().map_err(|_| wrong(()))?,
                _ => return Err(usage(format!("there is no option {name}"))),
            }
        }
        if parsed.cable.port() == 0 || parsed.wireless.port() == 0 {
            return Err(usage("a link's address needs a port, such as 127.0.0.1:7100"));
        }
        Ok(parsed)
    }

    /// QEMU's own words for a port that is taken are hard to understand.
    fn is_free(address: SocketAddr) -> Result<()> {
        TcpListener::bind(address).map(drop).map_err(|error| {
            Code::LinkBusy
                .error(
                    format!("cannot listen: {error}"),
                    "stop what listens there, or give other addresses with --cable and --wireless",
                )
                .at(address.to_string())
        })
    }

    fn usage(problem: impl Into<String>) -> Problem {
        Code::Usage.error(problem, "see --help")
    }
}

#[cfg(unix)]
fn main() -> std::process::ExitCode {
    match running::run() {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            error.exit_code().into()
        }
    }
}

#[cfg(not(unix))]
fn main() {
    eprintln!("error: this needs Unix sockets; `cargo wimu simulate` runs everywhere");
}
