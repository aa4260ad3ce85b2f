//! Writing through a debug probe.

use std::str::FromStr;

use probe_rs::architecture::arm::ArmError;
use probe_rs::flashing::{DownloadOptions, FlashProgress, ProgressEvent, ProgressOperation};
use probe_rs::probe::DebugProbeSelector;
use probe_rs::probe::list::{Accessibility, Lister, ProbeListItem};
use probe_rs::{Permissions, Session};
use serde::Serialize;
use wimu_host::{ErrorCode, HostError, Result};

use super::Image;
use crate::arguments::Flash;
use crate::output::Output;

#[derive(Serialize)]
struct Probe {
    name: String,
    /// For `--probe`.
    selector: String,
    accessible: bool,
}

impl From<&ProbeListItem> for Probe {
    fn from(item: &ProbeListItem) -> Self {
        Self {
            name: item.info.identifier.clone(),
            selector: DebugProbeSelector::from(&item.info).to_string(),
            accessible: item.accessibility == Accessibility::Accessible,
        }
    }
}

pub fn list(output: Output) -> Result<()> {
    #[derive(Serialize)]
    struct Probes {
        schema: &'static str,
        status: &'static str,
        probes: Vec<Probe>,
    }
    let probes: Vec<Probe> = Lister::new()
        .list_all_with_access()
        .iter()
        .map(Probe::from)
        .collect();
    if probes.is_empty() {
        output.say("no debug probe is plugged in");
    }
    for probe in &probes {
        let access = if probe.accessible {
            ""
        } else {
            " (not for this user)"
        };
        output.say(format!("{}  {}{access}", probe.selector, probe.name));
    }
    output.object(&Probes {
        schema: "wimu.probes/1",
        status: "ok",
        probes,
    });
    Ok(())
}

pub fn write(image: &Image, arguments: &Flash, output: Output) -> Result<()> {
    #[derive(Serialize)]
    struct Written {
        schema: &'static str,
        status: &'static str,
        board: &'static str,
        chip: &'static str,
        probe: String,
        image: String,
        bytes: usize,
    }
    let probe = choose(arguments.probe.as_deref(), image)?;
    let chip = image.board.chip().name;
    let mut session = attach(&probe, chip, arguments.erase_all, output)?;
    let mut loader = session.target().flash_loader();
    let mut bytes = 0;
    for (address, content) in &image.segments {
        bytes += content.len();
        let added = loader.add_data(u64::from(*address), content);
        added.map_err(|error| failed("the image does not fit the chip", &error))?;
    }
    let mut options = DownloadOptions::new();
    options.progress = progress(output);
    // Sectors that the image shares with something else keep it; the store has its own.
    options.keep_unwritten_bytes = true;
    options.verify = true;
    let outcome = loader.commit(&mut session, options);
    output.end_refresh();
    outcome.map_err(|error| failed("writing the flash failed", &error))?;
    let started = session.core(0).and_then(|mut core| core.reset());
    started.map_err(|error| failed("the image is written, but the chip did not start", &error))?;
    output.say(format!(
        "{bytes} bytes of {} are on the {}; `wimu ports` names its port",
        image.file.display(),
        image.board.name()
    ));
    output.object(&Written {
        schema: "wimu.flash/1",
        status: "ok",
        board: image.board.name(),
        chip,
        probe: Probe::from(&probe).selector,
        image: image.file.display().to_string(),
        bytes,
    });
    Ok(())
}

/// The probe that is named, or the only one.
fn choose(named: Option<&str>, image: &Image) -> Result<ProbeListItem> {
    let selector = named
        .map(|text| {
            DebugProbeSelector::from_str(text).map_err(|error| {
                HostError::new(
                    ErrorCode::Usage,
                    format!("`{text}` names no probe: {error}"),
                    "give VENDOR:PRODUCT or VENDOR:PRODUCT:SERIAL, as `wimu flash --list` shows them",
                )
            })
        })
        .transpose()?;
    let mut probes = Lister::new().list_with_access(selector.as_ref());
    let (file, drive) = (image.file.display(), image.board.file_and_drive().1);
    match probes.len() {
        0 => Err(HostError::new(
            ErrorCode::ProbeAbsent,
            match named {
                Some(named) => format!("there is no debug probe {named}"),
                None => "no debug probe is plugged in".into(),
            },
            format!(
                "plug one in (a micro:bit is its own, a Pico needs a Debug Probe on its SWD pins) \
                 with a cable that carries data, and see `wimu flash --list`; or copy {file} onto the \
                 board's drive {drive}"
            ),
        )),
        1 => {
            let probe = probes.remove(0);
            if probe.accessibility == Accessibility::PermissionDenied {
                return Err(forbidden(&probe));
            }
            Ok(probe)
        }
        _ => {
            let known: Vec<String> = probes.iter().map(|p| Probe::from(p).selector).collect();
            Err(HostError::new(
                ErrorCode::Usage,
                format!("there are {} debug probes", known.len()),
                format!("name one: --probe {}", known.join(" or --probe ")),
            ))
        }
    }
}

fn forbidden(probe: &ProbeListItem) -> HostError {
    let vendor = probe.info.vendor_id;
    HostError::new(
        ErrorCode::ProbePermission,
        format!("this user may not open the probe {}", probe.info),
        udev_rule(vendor),
    )
    .at(Probe::from(probe).selector)
}

/// What lets whoever sits at the computer open the probes of a maker.
fn udev_rule(vendor: u16) -> String {
    format!(
        "write these two lines into /etc/udev/rules.d/69-wimu-probe.rules, run `sudo udevadm control \
         --reload`, and plug the probe in again:\n\
         SUBSYSTEM==\"usb\", ATTR{{idVendor}}==\"{vendor:04x}\", MODE=\"0660\", TAG+=\"uaccess\"\n\
         KERNEL==\"hidraw*\", ATTRS{{idVendor}}==\"{vendor:04x}\", MODE=\"0660\", TAG+=\"uaccess\""
    )
}

/// Attaches to the chip. A locked one is unlocked only with consent, for that erases it.
fn attach(probe: &ProbeListItem, chip: &str, erase_all: bool, output: Output) -> Result<Session> {
    let permissions = if erase_all {
        output.say("if the chip is locked, all that is on it is erased now, its calibration too");
        Permissions::new().allow_erase_all()
    } else {
        Permissions::new()
    };
    let open = probe.info.open().map_err(|error| {
        HostError::new(
            ErrorCode::ProbePermission,
            format!("the probe {} does not open: {}", probe.info, chain(&error)),
            format!(
                "close other programs that use it; on Linux, {}",
                udev_rule(probe.info.vendor_id)
            ),
        )
    })?;
    open.attach(chip, permissions)
        .map_err(|error| refused(chip, error))
}

/// Why a chip does not let itself be attached to, and what to do.
fn refused(chip: &str, error: probe_rs::Error) -> HostError {
    match error {
        probe_rs::Error::MissingPermissions(_)
        | probe_rs::Error::Arm(ArmError::MissingPermissions(_)) => HostError::new(
            ErrorCode::ChipLocked,
            "the chip is locked: unlocking it erases all that is on it, its calibration and key too",
            "if nothing on it is needed, run the command again with --erase-all",
        ),
        other => HostError::new(
            ErrorCode::FlashFailed,
            format!("no {chip} answers at the probe: {}", chain(&other)),
            "check the board's power and the wires to SWDIO, SWCLK and ground, and that the board is the one named",
        ),
    }
}

fn progress<'a>(output: Output) -> FlashProgress<'a> {
    let mut totals = [0_u64; 4];
    let mut done = [0_u64; 4];
    let place = |operation: ProgressOperation| match operation {
        ProgressOperation::Fill => (0, "reading"),
        ProgressOperation::Erase => (1, "erasing"),
        ProgressOperation::Program => (2, "writing"),
        ProgressOperation::Verify => (3, "checking"),
    };
    FlashProgress::new(move |event| match event {
        ProgressEvent::AddProgressBar {
            operation,
            total: Some(total),
        } => totals[place(operation).0] += total,
        ProgressEvent::Progress {
            operation, size, ..
        } => {
            let (index, word) = place(operation);
            done[index] += size;
            let percent = done[index] * 100 / totals[index].max(1);
            output.refresh(&format!("{word} {:3} %", percent.min(100)));
        }
        _ => {}
    })
}

fn failed(what: &str, error: &dyn std::error::Error) -> HostError {
    HostError::new(
        ErrorCode::FlashFailed,
        format!("{what}: {}", chain(error)),
        "keep the cable plugged in, run the command again; a chip that refuses once more is erased with --erase-all",
    )
}

/// An error and what it comes from.
fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        text += &format!(": {cause}");
        source = cause.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::flash::Board;

    #[test]
    fn probe_rs_knows_the_chips_and_has_flash_where_the_images_are() {
        let registry = probe_rs::config::Registry::from_builtin_families();
        for board in [Board::MicrobitV2, Board::PicoAdxl345] {
            let chip = board.chip();
            let target = registry.get_target_by_name(chip.name).expect(chip.name);
            let mut loader = target.flash_loader();
            loader
                .add_data(chip.vectors.into(), &[0; 64])
                .expect("flash at the vectors");
            assert!(loader.add_data(chip.ram.end.into(), &[0; 64]).is_err());
        }
    }

    #[test]
    fn a_locked_chip_is_not_erased_without_consent_and_the_cost_is_named() {
        let missing = || ArmError::MissingPermissions("erase_all".into());
        let locked = refused("nRF52833_xxAA", probe_rs::Error::Arm(missing()));
        assert_eq!(locked.code(), ErrorCode::ChipLocked);
        let text = locked.to_string();
        assert!(
            text.contains("erases all") && text.contains("--erase-all"),
            "{text}"
        );
        // What is not the lock does not end in advice to erase.
        let silent = refused("RP2040", probe_rs::Error::Timeout);
        assert_eq!(silent.code(), ErrorCode::FlashFailed);
        let text = silent.to_string();
        assert!(text.contains("RP2040") && !text.contains("erase"), "{text}");
    }

    #[test]
    fn the_udev_rule_names_the_maker_for_both_kinds_of_probe() {
        let rule = udev_rule(0x0d28);
        assert_eq!(rule.matches("==\"0d28\"").count(), 2, "{rule}");
        assert!(rule.contains("hidraw*") && rule.contains("udevadm"));
    }
}
