//! Flash and RAM of the images against their limits.

use std::path::Path;

use wimu_testkit::figure;
use xshell::{Shell, cmd};

use crate::boards::{BARE_LOOP, Board, ESP32C3, MICROBIT, PICO, QEMU, XIAO, buildable};
use crate::size::Size;
use crate::{Result, instructions};

/// Where recordings are looked for: beside the repository, of which they are no part.
pub const DATA: &str = "../shared/data";
/// The most flash, bytes, that authentication may take in an image.
const AUTHENTICATION_LIMIT: u32 = 12 << 10;

/// An image, and the bytes it may take.
struct Image {
    what: &'static str,
    board: Board,
    program: &'static str,
    /// Features instead of the default ones.
    features: Option<&'static str>,
    /// Targets, KiB of flash and of RAM without the stack; 0: none.
    aims: [u32; 2],
    /// Limits, bytes: a little more than it takes, for another compiler's sake. Who makes it smaller lowers them.
    limits: [u32; 2],
}

const fn image(what: &'static str, board: Board, aims: [u32; 2], limits: [u32; 2]) -> Image {
    Image { what, program: board.program, board, features: None, aims, limits }
}

/// A choice of the node's features on the micro:bit.
const fn profile(
    what: &'static str,
    features: &'static str,
    aims: [u32; 2],
    limits: [u32; 2],
) -> Image {
    Image { features: Some(features), ..image(what, MICROBIT, aims, limits) }
}

/// A function on a Cortex-M4F; its flash is that beyond the program [`EMPTY`].
const fn function(what: &'static str, program: &'static str, aim: u32, limit: u32) -> Image {
    Image { program, ..image(what, BARE_LOOP, [aim, 0], [limit, u32::MAX]) }
}

const EMPTY: &str = "empty";
/// The image of the lane `test`, optimised for speed.
const QEMU_IMAGE: Image = image("image for QEMU", QEMU, [0, 0], [252_000, 27_300]);
const IMAGES: [Image; 8] = [
    QEMU_IMAGE,
    profile("profile stream", "", [48, 8], [46_300, 6_900]),
    profile("profile navigate", "navigate", [66, 11], [67_200, 10_500]),
    // The default: the image that is left.
    image("profile full, micro:bit", MICROBIT, [81, 16], [78_600, 16_384]),
    image("Pico", PICO, [80, 16], [108_200, 22_000]),
    // Half of it is the controller and the host stack of Bluetooth: it has no target.
    image("XIAO nRF52840 with BLE and USB", XIAO, [0, 0], [200_500, 40_000]),
    // Likewise, and most of the RAM is the radio's heap.
    image("ESP32-C3 with BLE and USB", ESP32C3, [0, 0], [455_000, 102_000]),
    function("bare loop", "bare-loop", 8, 14_000),
];

/// Prints all measured figures: sizes, bytes on the wire, accuracy, instructions.
pub fn run(sh: &Shell) -> Result {
    sizes(sh)?;
    cmd!(sh, "cargo run --release --quiet -p wimu-integrator --example accuracy").run()?;
    let data = Path::new(DATA).is_dir().then_some(DATA);
    cmd!(sh, "cargo run --release --quiet -p wimu-link --example wire_budget -- {data...}")
        .run()?;
    instructions::run(sh)
}

/// Builds the images and prints their sizes.
pub fn sizes(sh: &Shell) -> Result {
    let boards = buildable(sh);
    let mut problems = Vec::new();
    for image in &IMAGES {
        if boards.iter().all(|board| board.folder != image.board.folder) {
            continue;
        }
        match image.features {
            Some(features) => {
                image.board.build(sh, &["--no-default-features", "--features", features])?
            }
            None => image.board.build(sh, &[])?,
        }
        problems.extend(image.measure()?);
    }
    if problems.is_empty() { Ok(()) } else { Err(problems.join("; ").into()) }
}

/// Checks that the image for QEMU, already built, is within its limits.
pub fn check_qemu() -> Result {
    let problems = QEMU_IMAGE.measure()?;
    if problems.is_empty() { Ok(()) } else { Err(problems.join("; ").into()) }
}

impl Image {
    /// Prints the size of the image and says what is past its limit.
    fn measure(&self) -> Result<Vec<String>> {
        let mut size = Size::read(&self.board.image(self.program))?;
        let mut problems = Vec::new();
        if self.board.folder == BARE_LOOP.folder {
            size.flash = size.flash.saturating_sub(Size::read(&self.board.image(EMPTY))?.flash);
        } else {
            println!("authentication, {}: {} bytes of flash", self.what, size.authentication);
            self.measure_part("RAM without the stack", size.ram, 1, &mut problems);
        }
        self.measure_part("flash", size.flash, 0, &mut problems);
        if size.authentication > AUTHENTICATION_LIMIT {
            problems.push(format!(
                "{}: authentication takes over {AUTHENTICATION_LIMIT} bytes",
                self.what
            ));
        }
        Ok(problems)
    }

    fn measure_part(&self, part: &str, bytes: u32, index: usize, problems: &mut Vec<String>) {
        let (aim, limit) = (self.aims[index], self.limits[index]);
        let target = if aim > 0 { format!("at most {aim} KiB") } else { "–".into() };
        let measured = format!("{:.1} KiB", f64::from(bytes) / 1024.0);
        figure(
            &format!("{part}, {}", self.what),
            measured,
            &target,
            aim == 0 || bytes <= aim << 10,
        );
        if bytes > limit {
            problems.push(format!("{}: {bytes} bytes of {part}, limit {limit}", self.what));
        }
    }
}

/// What an image prints by semihosting on a machine of QEMU.
pub fn qemu(sh: &Shell, machine: &str, options: &[&str], image: &Path) -> Result<String> {
    let quiet = ["-display", "none", "-monitor", "none", "-serial", "none"];
    let semihosting = ["-semihosting-config", "enable=on,target=native"];
    Ok(cmd!(
        sh,
        "qemu-system-arm -M {machine} {quiet...} {semihosting...} {options...} -kernel {image}"
    )
    .read()?)
}
