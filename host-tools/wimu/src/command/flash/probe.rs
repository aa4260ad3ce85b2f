//! Writing an image through a debug probe.

use std::str::FromStr;

use probe_rs::architecture::arm::ArmError;
use probe_rs::flashing::{DownloadOptions, FlashProgress, ProgressEvent, ProgressOperation};
use probe_rs::probe::DebugProbeSelector;
use probe_rs::probe::list::{Accessibility, Lister, ProbeListItem};
use probe_rs::{Permissions, Session};
use serde::Serialize;
use wimu_host::{Code, Problem, Result};

use super::Image;
use crate::arguments::Flash;
use crate::output::{Output, usage};

#[derive(Serialize)]
struct Probe {
    name: String,
    /// Value for `--probe`.
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

pub fn list(output: &Output) -> Result<()> {
    #[derive(Serialize)]
    struct Probes {
        probes: Vec<Probe>,
    }
    let probes: Vec<Probe> = Lister::new().list_all_with_access().iter().map(Probe::from).collect();
    if probes.is_empty() {
        output.print("no debug probe is connected");
    }
    for probe in &probes {
        let access = if probe.accessible { "" } else { " (no permission)" };
        output.print(format!("{}  {}{access}", probe.selector, probe.name));
    }
    output.object(&Probes { probes });
    Ok(())
}

pub fn write(image: &Image, arguments: &Flash, output: &Output) -> Result<()> {
    #[derive(Serialize)]
    struct Written {
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
    // Keeps other contents of sectors that the image uses in part; the store has sectors of its own.
    options.keep_unwritten_bytes = true;
    options.verify = true;
    let outcome = loader.commit(&mut session, options);
    output.end_refresh();
    outcome.map_err(|error| failed("writing the flash failed", &error))?;
    let started = session.core(0).and_then(|mut core| core.reset());
    started.map_err(|error| failed("the image is written, but the chip did not start", &error))?;
    output.print(format!(
        "wrote {bytes} bytes of {} to the {}; `wimu device ports` shows its port",
        image.file.display(),
        image.board.name()
    ));
    let written = Written {
        board: image.board.name(),
        chip,
        probe: Probe::from(&probe).selector,
        image: image.file.display().to_string(),
        bytes,
    };
    output.object(&written);
    Ok(())
}

/// The named probe, or the only one.
fn choose(named: Option<&str>, image: &Image) -> Result<ProbeListItem> {
    let selector = named
        .map(|text| {
            DebugProbeSelector::from_str(text).map_err(|error| {
                usage(
                    format!("`{text}` is not a probe selector: {error}"),
                    "give VENDOR:PRODUCT or VENDOR:PRODUCT:SERIAL, as `wimu device flash --list` shows them",
                )
            })
        })
        .transpose()?;
    let mut probes = Lister::new().list_with_access(selector.as_ref());
    let (file, drive) = (image.file.display(), image.board.file_and_drive().1);
    match probes.len() {
        0 => Err(Code::ProbeAbsent.error(match named {
                Some(named) => format!("there is no debug probe {named}"),
                None => "no debug probe is connected".into(),
            },
            format!(
                "connect one (a micro:bit has its own, a Pico needs a Debug Probe on its SWD pins) with a \
                 cable that carries data; or copy {file} to the board's drive {drive}"
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
            Err(usage(
                format!("there are {} debug probes", known.len()),
                format!("name one: --probe {}", known.join(" or --probe ")),
            ))
        }
    }
}

fn forbidden(probe: &ProbeListItem) -> Problem {
    let vendor = probe.info.vendor_id;
    Code::ProbePermission
        .error(format!("no permission to open the probe {}", probe.info), udev_rule(vendor))
        .at(Probe::from(probe).selector)
}

/// How to let the logged-in user open the probes of a vendor.
fn udev_rule(vendor: u16) -> String {
    format!(
        "write these two lines to /etc/udev/rules.d/69-wimu-probe.rules, run `sudo udevadm control \
         --reload`, and reconnect the probe:\n\
         SUBSYSTEM==\"usb\", ATTR{{idVendor}}==\"{vendor:04x}\", MODE=\"0660\", TAG+=\"uaccess\"\n\
         KERNEL==\"hidraw*\", ATTRS{{idVendor}}==\"{vendor:04x}\", MODE=\"0660\", TAG+=\"uaccess\""
    )
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
        Code::ProbePermission.error(
            format!("cannot open the probe {}: {}", probe.info, chain(&error)),
            format!(
                "close other programs that use it; on Linux, {}",
                udev_rule(probe.info.vendor_id)
            ),
        )
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

fn progress(output: &Output) -> FlashProgress<'_> {
    let mut totals = [0_u64; 4];
    let mut done = [0_u64; 4];
    let place = |operation: ProgressOperation| match operation {
        ProgressOperation::Fill => (0, "reading"),
        ProgressOperation::Erase => (1, "erasing"),
        ProgressOperation::Program => (2, "writing"),
        ProgressOperation::Verify => (3, "checking"),
    };
    FlashProgress::new(move |event| match event {
        ProgressEvent::AddProgressBar { operation, total: Some(total) } => {
            totals[place(operation).0] += total
        }
        ProgressEvent::Progress { operation, size, .. } => {
            let (index, word) = place(operation);
            done[index] += size;
            let percent = done[index] * 100 / totals[index].max(1);
            output.refresh(&format!("{word} {:3} %", percent.min(100)));
        }
        _ => {}
    })
}

fn failed(what: &str, error: &dyn std::error::Error) -> Problem {
    Code::FlashFailed.error(
        format!("{what}: {}", chain(error)),
        "keep the cable connected and try again; if it fails again, --erase-all erases the chip",
    )
}

/// An error with its causes.
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
        for board in [Board::MicrobitV2, Board::PicoAdxl345, Board::Nrf52840Ble] {
            let chip = board.chip();
            let target = registry.get_target_by_name(chip.name).expect(chip.name);
            let mut loader = target.flash_loader();
            loader.add_data(chip.vectors.into(), &[0; 64]).expect("flash at the vectors");
            assert!(loader.add_data(chip.ram.end.into(), &[0; 64]).is_err());
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

    #[test]
    fn the_udev_rule_names_the_maker_for_both_kinds_of_probe() {
        let rule = udev_rule(0x0d28);
        assert_eq!(rule.matches("==\"0d28\"").count(), 2, "{rule}");
        assert!(rule.contains("hidraw*") && rule.contains("udevadm"));
    }
}
