//! Flash and RAM of the node's profiles, each a choice of features of the micro:bit's image, and of the bare loop.

use std::path::Path;

use wimu_testkit::figure;

use crate::command_line::heading;
use crate::firmware;
use crate::setup::{self, Need, ThisMachine};
use crate::size::Size;

const BOARD: &str = "firmware/microbit-v2";
const PROGRAM: &str = "wimu-microbit-v2";
const LOOP: &str = "firmware/calibration";
const TARGET: &str = "thumbv7em-none-eabihf";

/// Bytes.
struct Limit {
    /// What it should take.
    aim: u32,
    /// The most that it may take: a little more than it does, for another compiler's sake.
    most: u32,
}

struct Profile {
    name: &'static str,
    /// Those of the image, without its default ones.
    features: &'static str,
    flash: Limit,
    /// Without the stack.
    ram: Limit,
}

const fn kib(aim: u32, most: u32) -> Limit {
    Limit { aim: aim << 10, most }
}

const PROFILES: [Profile; 3] = [
    Profile { name: "stream", features: "", flash: kib(48, 54_700), ram: kib(8, 8_192) },
    Profile {
        name: "navigate",
        features: "navigate",
        flash: kib(64, 95_900),
        ram: kib(12, 15_700),
    },
    Profile { name: "full", features: "full", flash: kib(80, 116_000), ram: kib(16, 21_900) },
];

/// The bare loop, and the image that it is compared with.
const BARE_LOOP: (&str, &str) = ("bare-loop", "calibration-empty");
const BARE_LOOP_FLASH: Limit = kib(3, 13_000);

/// Builds the profiles and prints their sizes.
///
/// # Errors
/// Says which command failed, which image cannot be read, or which is too large.
pub fn run() -> Result<(), String> {
    heading("profiles of the node on the micro:bit v2, Cortex-M4F");
    let source = setup::provide(Need::Targets, &mut ThisMachine)?;
    let mut too_large = Vec::new();
    let mut measure = |what: String, bytes: u32, limit: &Limit| {
        let kib = |bytes: u32| format!("{:.1} KiB", f64::from(bytes) / 1024.0);
        let target = format!("at most {}", kib(limit.aim));
        figure(&what, kib(bytes), &target, bytes <= limit.aim);
        if bytes > limit.most {
            too_large.push(format!("{what}: {bytes} bytes, at most {} are allowed", limit.most));
        }
    };
    for profile in &PROFILES {
        let folder = Path::new(BOARD);
        let options = format!("--no-default-features --features={}", profile.features);
        let output = firmware::built_with(source, folder, None, &options)?;
        let size = Size::read(&output.image(PROGRAM, TARGET))?;
        let name = profile.name;
        measure(format!("flash of the profile {name}"), size.flash, &profile.flash);
        measure(format!("RAM of the profile {name}, without the stack"), size.ram, &profile.ram);
    }
    let output = firmware::built(source, Path::new(LOOP), None)?;
    let flash = |program| Size::read(&output.image(program, TARGET)).map(|size| size.flash);
    let (program, empty) = BARE_LOOP;
    let bytes = flash(program)?.saturating_sub(flash(empty)?);
    measure("flash of the bare loop".into(), bytes, &BARE_LOOP_FLASH);
    match too_large {
        none if none.is_empty() => Ok(()),
        some => Err(some.join("; ")),
    }
}
