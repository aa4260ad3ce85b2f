//! Writing an image through a debug probe.

use std::io::Cursor;
use std::str::FromStr;

use probe_rs::architecture::arm::ArmError;
use probe_rs::flashing::{DownloadOptions, HexLoader, Uf2Loader};
use probe_rs::probe::DebugProbeSelector;
use probe_rs::probe::list::{Lister, ProbeListItem};
use probe_rs::{Permissions, Session};
use wimu_host::{Code, Problem, Result};

use super::image::Format;
use super::{Facts, Image};
use crate::arguments::Flash;
use crate::output::{Output, usage};

/// How the logged-in user may open a probe.
const UDEV: &str = "on Linux, install the udev rules of https://probe.rs/docs/getting-started/probe-setup and reconnect it";

/// Value for `--probe`.
fn selector(probe: &ProbeListItem) -> String {
    DebugProbeSelector::from(&probe.info).to_string()
}

pub fn write(image: &Image, arguments: &Flash, output: &Output) -> Result<()> {
    let probe = choose(arguments.probe.as_deref(), &image.board)?;
    let mut session = attach(&probe, image.board.chip, arguments.erase_all, output)?;
    let mut loader = session.target().flash_loader();
    let mut file = Cursor::new(&image.bytes);
    let loaded = match image.board.format {
        Format::Hex => loader.load_image(&mut session, &mut file, HexLoader, None),
        Format::Uf2 { .. } => loader.load_image(&mut session, &mut file, Uf2Loader, None),
    };
    loaded.map_err(|error| failed("the image does not fit the chip", &error))?;
    let mut options = DownloadOptions::new();
    // Keeps other contents of sectors that the image uses in part; the store has sectors of its own.
    options.keep_unwritten_bytes = true;
    options.verify = true;
    output.refresh("writing and checking");
    let outcome = loader.commit(&mut session, options);
    output.end_refresh();
    outcome.map_err(|error| failed("writing the flash failed", &error))?;
    let started = session.core(0).and_then(|mut core| core.reset());
    started.map_err(|error| failed("the image is written, but the chip did not start", &error))?;
    super::done(image, &selector(&probe), output);
    Ok(())
}

/// The named probe, or the only one.
fn choose(named: Option<&str>, board: &Facts) -> Result<ProbeListItem> {
    let wanted = named.map(DebugProbeSelector::from_str).transpose().map_err(|error| {
        let remedy = "give VENDOR:PRODUCT or VENDOR:PRODUCT:SERIAL, hexadecimal";
        usage(format!("--probe is not a probe selector: {error}"), remedy)
    })?;
    let mut probes = Lister::new().list_with_access(wanted.as_ref());
    let Some(probe) = probes.pop() else {
        let text = named.map_or("no debug probe is connected".into(), |named| {
            format!("there is no debug probe {named}")
        });
        let Facts { drive, shown, .. } = board;
        let remedy = format!("connect one, or let the board show its drive {drive}: {shown}");
        return Err(Code::ProbeAbsent.error(text, remedy));
    };
    if probes.is_empty() {
        return Ok(probe);
    }
    let known: Vec<String> = probes.iter().chain([&probe]).map(selector).collect();
    let remedy = format!("name one: --probe {}", known.join(" or --probe "));
    Err(usage(format!("there are {} debug probes", known.len()), remedy))
}

/// Attaches to the chip. Unlocking a locked chip erases it and needs `--erase-all`.
fn attach(probe: &ProbeListItem, chip: &str, erase_all: bool, output: &Output) -> Result<Session> {
    let permissions = if erase_all {
        output.print("a locked chip is erased now, with its firmware, calibration and key");
        Permissions::new().allow_erase_all()
    } else {
        Permissions::new()
    };
    let open = probe.info.open().map_err(|error| {
        let text = format!("cannot open the probe {}: {}", probe.info, chain(&error));
        Code::ProbePermission.error(text, format!("close other programs that use it; {UDEV}"))
    })?;
    open.attach(chip, permissions).map_err(|error| refused(chip, error))
}

/// Why attaching to a chip failed, and what to do.
fn refused(chip: &str, error: probe_rs::Error) -> Problem {
    match error {
        probe_rs::Error::MissingPermissions(_)
        | probe_rs::Error::Arm(ArmError::MissingPermissions(_)) => Code::ChipLocked.error(
            "the chip is locked; unlocking erases all of it, with its calibration and key",
            "if nothing on it is needed, add --erase-all",
        ),
        other => Code::FlashFailed.error(
            format!("no {chip} answers at the probe: {}", chain(&other)),
            "check the board's power, the wires to SWDIO, SWCLK and ground, and the board's name",
        ),
    }
}

fn failed(what: &str, error: &dyn std::error::Error) -> Problem {
    Code::FlashFailed.error(
        format!("{what}: {}", chain(error)),
        "keep the cable connected and try again; if it fails again, --erase-all erases the chip",
    )
}

/// An error with its causes.
fn chain(error: &dyn std::error::Error) -> String {
    let errors = std::iter::successors(Some(error), |error| error.source());
    errors.map(ToString::to_string).collect::<Vec<_>>().join(": ")
}

#[cfg(test)]
mod tests {
    use clap::ValueEnum as _;

    use super::*;
    use crate::arguments::Board;

    #[test]
    fn probe_rs_knows_the_chips() {
        let registry = probe_rs::config::Registry::from_builtin_families();
        for board in Board::value_variants().iter().map(|board| board.facts()) {
            registry.get_target_by_name(board.chip).expect(board.chip);
        }
    }

    #[test]
    fn a_locked_chip_is_not_erased_without_consent_and_the_cost_is_named() {
        let missing = || ArmError::MissingPermissions("erase_all".into());
        let locked = refused("nRF52833_xxAA", probe_rs::Error::Arm(missing()));
        assert_eq!(locked.code, Code::ChipLocked);
        let text = locked.to_string();
        assert!(text.contains("erases all") && text.contains("--erase-all"), "{text}");
        // What is not the lock does not end in advice to erase.
        let silent = refused("RP2040", probe_rs::Error::Timeout);
        assert_eq!(silent.code, Code::FlashFailed);
        let text = silent.to_string();
        assert!(text.contains("RP2040") && !text.contains("erase"), "{text}");
    }
}
