//! How much flash and RAM an image takes, in whole and by crate, read from its ELF file.

use std::collections::BTreeMap;
use std::path::Path;

use object::elf::{SHF_ALLOC, SHF_WRITE};
use object::read::elf::ElfFile32;
use object::{Object as _, ObjectSection as _, ObjectSymbol as _, SectionFlags, SymbolKind};
use wimu_testkit::figure;

use crate::command_line::{CommandLine, heading};
use crate::firmware;
use crate::output::Output;
use crate::setup::{self, Need, TARGETS, ThisMachine};
use crate::workspace::Workspace;

/// Crates below this many bytes are added up.
const WORTH_A_LINE: u32 = 1024;
/// What signs and checks writes: whatever has one of these in its name. What the compiler has put into
/// its callers is not among it.
const AUTHENTICATION: [&str; 6] =
    ["wimu_link::auth::", "sha2::", "hmac::", "digest::", "block_buffer::", "crypto_common::"];
/// The most flash, bytes, that authentication may take in an image.
const MOST_AUTHENTICATION: u32 = 12 << 10;
/// The most bytes of flash, and of RAM without the stack, that an image may take: a little more than it
/// does, for another compiler's sake. Who makes it smaller lowers them.
const MOST: [(&str, u32, u32); 3] = [
    ("wimu-microbit-v2", 113 << 10, 22_000),
    ("wimu-pico-adxl345", 111 << 10, 22_000),
    (WITH_RADIO, 230 << 10, 42_000),
];
/// Half of it is the controller and the host stack of Bluetooth: it has no target.
const WITH_RADIO: &str = "wimu-nrf52840-ble";
/// The images of `firmware/calibration`: what is measured, and the most flash it may take, bytes.
const CALIBRATION_TARGET: &str = "thumbv7em-none-eabihf";
const EMPTY: &str = "calibration-empty";
const CALIBRATIONS: [(&str, &str, u32); 4] = [
    ("calibration-minimal-f32", "minimal_fit::<f32>", 24 << 10),
    ("calibration-minimal-f64", "minimal_fit::<f64>", u32::MAX),
    ("calibration-multi-position", "multi_position", u32::MAX),
    ("calibration-best-model", "best_model", u32::MAX),
];
/// What an image should take, bytes.
const AIM_FLASH: u32 = 48 << 10;
const AIM_RAM: u32 = 12 << 10;
/// Where the RAM of Cortex-M is.
const RAM: std::ops::Range<u32> = 0x2000_0000..0x4000_0000;

/// Builds every board and prints the sizes of its images.
///
/// # Errors
/// Says which command failed, which image cannot be read, or which is too large.
pub fn run(workspace: &Workspace) -> Result<(), String> {
    let found = built(workspace)?;
    calibrations(workspace, &found)?;
    for (name, size) in found.iter().filter(|(name, _)| !is_calibration(name)) {
        heading(name);
        print!("{}", table(size));
        if name == WITH_RADIO || !MOST.iter().any(|(board, ..)| board == name) {
            continue;
        }
        for (what, bytes, aim) in
            [("flash", size.flash, AIM_FLASH), ("RAM without the stack", size.ram, AIM_RAM)]
        {
            let kib = |bytes| f64::from(bytes) / 1024.0;
            let target = format!("at most {:.0} KiB", kib(aim));
            let claim = format!("{what} of the image {name}");
            figure(&claim, format!("{:.1} KiB", kib(bytes)), &target, bytes <= aim);
        }
    }
    small_enough(&found)
}

fn is_calibration(program: &str) -> bool {
    program == EMPTY || CALIBRATIONS.iter().any(|(name, ..)| *name == program)
}

/// Prints the flash and the stack that each function of wimu-calib takes; the stack where QEMU is
/// installed.
fn calibrations(workspace: &Workspace, found: &[(String, Size)]) -> Result<(), String> {
    heading("wimu-calib on Cortex-M4F");
    let folder = workspace.firmware.iter().find(|f| f.ends_with("calibration"));
    let output = Output::of(folder.ok_or("firmware/calibration is missing")?)?;
    for (program, about, most) in CALIBRATIONS {
        let flash = attributable(found, program)?;
        let target =
            if most < u32::MAX { format!("at most {} KiB", most >> 10) } else { "–".into() };
        let measured = format!("{:.1} KiB", f64::from(flash) / 1024.0);
        let claim = format!("flash of {about}, Cortex-M4F");
        figure(&claim, measured, &target, flash <= most);
        let image = output.image(program, CALIBRATION_TARGET);
        let run = CommandLine::new("qemu-system-arm -M mps2-an386 -display none -monitor none")
            .words("-serial none -semihosting-config enable=on,target=native -kernel")
            .word(&image.display().to_string());
        match run.output().and_then(|text| text.trim().parse::<u32>().ok()) {
            Some(stack) => println!("stack of {about}: {:.1} KiB", f64::from(stack) / 1024.0),
            None => println!("stack of {about}: not measured, `{run}` failed"),
        }
    }
    Ok(())
}

/// Flash of a calibration beyond that of the empty image, bytes.
fn attributable(found: &[(String, Size)], program: &str) -> Result<u32, String> {
    let flash = |program: &str| {
        let size = found.iter().find(|(name, _)| name == program);
        size.map(|(_, size)| size.flash).ok_or_else(|| format!("{program} was not built"))
    };
    Ok(flash(program)?.saturating_sub(flash(EMPTY)?))
}

/// Builds every board, and looks whether its image is as small as it is to be.
///
/// # Errors
/// As [`run`].
pub fn check(workspace: &Workspace) -> Result<(), String> {
    small_enough(&built(workspace)?)
}

/// Checks that each image is within its size limits.
fn small_enough(found: &[(String, Size)]) -> Result<(), String> {
    for (name, size) in found {
        within(name, size)?;
    }
    for (program, about, most) in CALIBRATIONS {
        let flash = attributable(found, program)?;
        if flash > most {
            return Err(format!(
                "{about} takes {flash} bytes of flash, at most {most} are allowed"
            ));
        }
    }
    Ok(())
}

/// The images of all boards, by the names of their programs.
fn built(workspace: &Workspace) -> Result<Vec<(String, Size)>, String> {
    let source = setup::provide(Need::Targets, &mut ThisMachine)?;
    let mut found = Vec::new();
    for folder in firmware::buildable(workspace) {
        let output = firmware::built(source, folder, None)?;
        for program in &output.programs {
            for target in TARGETS {
                // A board is built for one of them only.
                let image = output.image(program, target);
                if image.is_file() {
                    found.push((program.clone(), Size::read(&image)?));
                }
            }
        }
    }
    Ok(found)
}

/// Whether the image of a program is as small as it is to be.
fn within(program: &str, size: &Size) -> Result<(), String> {
    let most = MOST.iter().find(|(name, ..)| *name == program);
    let (_, flash, ram) = *most.unwrap_or(&("", u32::MAX, u32::MAX));
    for (what, bytes, most) in [
        ("flash", size.flash, flash),
        ("RAM without the stack", size.ram, ram),
        ("flash for authentication", size.authentication, MOST_AUTHENTICATION),
    ] {
        if bytes > most {
            return Err(format!(
                "{program} takes {bytes} bytes of {what}, at most {most} are allowed"
            ));
        }
    }
    Ok(())
}

/// Bytes.
#[derive(Debug, Default, PartialEq)]
pub struct Size {
    pub flash: u32,
    /// Without the stack.
    pub ram: u32,
    /// Flash of [`AUTHENTICATION`].
    authentication: u32,
    /// What has a name, by the crate that it is from.
    crates: BTreeMap<String, Share>,
}

/// Bytes of one crate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Share {
    /// Functions and constants.
    flash: u32,
    /// Variables.
    ram: u32,
}

impl Share {
    fn total(self) -> u32 {
        self.flash + self.ram
    }
}

impl Size {
    /// Of the image in a file.
    ///
    /// # Errors
    /// Says why it cannot be read.
    pub fn read(image: &Path) -> Result<Self, String> {
        let failed = |error: &dyn std::fmt::Display| format!("{}: {error}", image.display());
        let bytes = std::fs::read(image).map_err(|error| failed(&error))?;
        Self::of(&bytes).map_err(|error| failed(&error))
    }

    /// Of a 32-bit little-endian ELF file.
    fn of(elf: &[u8]) -> object::Result<Self> {
        let elf = ElfFile32::<object::LittleEndian>::parse(elf)?;
        let mut size = Self::default();
        for section in elf.sections() {
            let SectionFlags::Elf { sh_flags, .. } = section.flags() else {
                continue;
            };
            let bytes = section.size() as u32;
            if sh_flags.0 & SHF_ALLOC.0 == 0 {
                continue;
            }
            // Initial values are in flash, and their variables in RAM.
            let stored = section.file_range().is_some();
            size.flash += if stored { bytes } else { 0 };
            let written = sh_flags.0 & SHF_WRITE.0 != 0;
            size.ram += if written { bytes } else { 0 };
        }
        let named = |kind| [SymbolKind::Text, SymbolKind::Data].contains(&kind);
        for symbol in elf.symbols().filter(|symbol| named(symbol.kind())) {
            let name = symbol.name()?;
            let bytes = symbol.size() as u32;
            let share = size.crates.entry(crate_of(name)).or_default();
            if RAM.contains(&(symbol.address() as u32)) {
                share.ram += bytes;
            } else {
                share.flash += bytes;
                if authenticates(name) {
                    size.authentication += bytes;
                }
            }
        }
        Ok(size)
    }
}

/// The crate in a mangled name: that of its first path, or of the first type in it.
fn crate_of(symbol: &str) -> String {
    let Ok(name) = rustc_demangle::try_demangle(symbol) else {
        return "without a crate".into();
    };
    let name = format!("{name:#}");
    let mut path = name.as_str();
    // `<&mut wimu_link::batch::Batch as …>`, `<[u8; 3] as …>`.
    while let Some(rest) = path.strip_prefix(['<', '&', '[', '(', '*']) {
        path = rest;
        for word in ["mut ", "const ", "dyn "] {
            path = path.strip_prefix(word).unwrap_or(path);
        }
    }
    let end = path.find(|c: char| !c.is_ascii_alphanumeric() && c != '_');
    let (first, rest) = path.split_at(end.unwrap_or(path.len()));
    // What is done for a type of the language is done by the standard library.
    if rest.starts_with("::") { first } else { "core" }.into()
}

/// Whether a mangled name is of what signs and checks writes.
fn authenticates(symbol: &str) -> bool {
    let name = rustc_demangle::demangle(symbol);
    let name = format!("{name:#}");
    AUTHENTICATION.iter().any(|part| name.contains(part))
}

fn table(size: &Size) -> String {
    let mut text =
        format!("in all       flash {:>7}  RAM {:>6} and the stack, bytes\n", size.flash, size.ram);
    let mut line = |name: &str, share: Share| {
        let Share { flash, ram } = share;
        text += &format!("             flash {flash:>7}  RAM {ram:>6}  {name}\n");
    };
    let mut crates: Vec<_> = size.crates.iter().collect();
    crates.sort_by_key(|&(_, share)| std::cmp::Reverse(share.total()));
    let mut others = Share::default();
    for (name, &share) in crates {
        if share.total() >= WORTH_A_LINE {
            line(name, share);
        } else {
            others.flash += share.flash;
            others.ram += share.ram;
        }
    }
    line("in all others", others);
    let authentication = Share { flash: size.authentication, ram: 0 };
    let named: u32 = size.crates.values().map(|share| share.flash).sum();
    let unnamed = Share { flash: size.flash.saturating_sub(named), ram: 0 };
    line("without a name: texts, tables, initial values", unnamed);
    let most = format!("of all this authentication, {MOST_AUTHENTICATION} at most");
    line(&most, authentication);
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crate_is_found_in_a_mangled_name() {
        for (symbol, of) in [
            ("_ZN9wimu_link5batch11encode_axis17h7acac7af30088277E", "wimu_link"),
            (
                "_ZN60_$LT$wimu_link..batch..Batch$u20$as$u20$core..fmt..Debug$GT$3fmt17h7acac7af30088277E",
                "wimu_link",
            ),
            ("_RNvCs15kBYyAo9fc_7mycrate7example", "mycrate"),
            ("_RNvXCs15kBYyAo9fc_4coreaNtB2_5Debug3fmt", "core"),
            ("__aeabi_memclr4", "without a crate"),
            ("_ZN", "without a crate"),
        ] {
            assert_eq!(crate_of(symbol), of, "{symbol}");
        }
    }

    #[test]
    fn authentication_is_told_by_its_names() {
        for (symbol, is) in [
            ("_ZN9wimu_link4auth8Sessions4note17h7acac7af30088277E", true),
            ("_ZN4sha26sha25615compress_blocks17h7acac7af30088277E", true),
            ("_ZN9wimu_link5batch11encode_axis17h7acac7af30088277E", false),
        ] {
            assert_eq!(authenticates(symbol), is, "{symbol}");
        }
    }

    #[test]
    fn an_image_that_has_grown_is_refused() {
        let (program, flash, ram) = MOST[0];
        let size = |flash, ram| Size { flash, ram, ..Size::default() };
        assert_eq!(within(program, &size(flash, ram)), Ok(()));
        for grown in [size(flash + 1, ram), size(flash, ram + 1)] {
            let refusal = within(program, &grown).expect_err("too large");
            assert!(refusal.starts_with(program), "{refusal}");
        }
        assert_eq!(within("wimu-qemu-mps2", &size(1 << 20, 1 << 20)), Ok(()));
    }

    #[test]
    fn a_calibration_that_has_grown_is_refused() {
        let found = |extra: u32| -> Vec<(String, Size)> {
            let images =
                CALIBRATIONS.map(|(name, _, most)| (name, 100 + most.min(1 << 20) + extra));
            let images = images.into_iter().chain([(EMPTY, 100)]);
            let size = |flash| Size { flash, ..Size::default() };
            images.map(|(name, flash)| (name.to_owned(), size(flash))).collect()
        };
        assert_eq!(small_enough(&found(0)), Ok(()));
        let refusal = small_enough(&found(1)).expect_err("too large");
        assert!(refusal.starts_with("minimal_fit::<f32>"), "{refusal}");
        assert!(small_enough(&[]).is_err());
    }

    #[test]
    fn what_is_no_elf_file_has_no_size() {
        for damaged in [&b""[..], b"\x7fELF\x01\x01", &[0; 64]] {
            assert!(Size::of(damaged).is_err());
        }
    }

    #[test]
    fn small_crates_are_added_up() {
        let size = Size {
            flash: 5000,
            ram: 12,
            authentication: 321,
            crates: [("big", 4000), ("a", 10), ("b", 20)]
                .map(|(name, flash)| (name.to_owned(), Share { flash, ram: 4 }))
                .into(),
        };
        let text = table(&size);
        assert!(
            text.contains("4000  RAM      4  big")
                && text.contains("30  RAM      8  in all others")
                && text.contains("321  RAM      0  of all this authentication, 12288 at most"),
            "{text}"
        );
    }
}
