//! A recording as a table.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use wimu_model::{DeviceTimeUs, SpecificForceQ16};

use crate::csv::{AccelerationUnit, CsvWriter, Header, Row};
use crate::history::{Boot, LinkHistory};
use crate::mcap_file::ClockAnchor;
use crate::{ErrorCode, HostError, Result};

/// The column that says whether the magnetic field is corrected.
const FIELD_CALIBRATED: &str = "Field Calibrated";

/// The column of the heading's standard deviation, empty where it is uncalibrated.
const HEADING_SD: &str = "Heading SD (deg)";

/// What a table holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportStream {
    /// Counts, LSB, with magnetic field as the magnetometer put it out, and temperature.
    Raw,
    /// Specific force, m/s², body axes, as the device corrected it. Where `Field Calibrated` is 1
    /// the magnetic field is corrected by the parameters in use then, body axes; where it is 0 it is
    /// as the magnetometer put it out.
    Corrected,
    /// Velocity and position, as the device integrated them. North is magnetic where `Heading SD` has
    /// a value.
    Navigation,
}

/// Writes a stream of `link` as a CSV file; times are UTC where `anchor` tells it, device time
/// elsewhere. Returns how many rows were written.
///
/// # Errors
/// `no_rows` when the link carried no such stream; `file_failed`, `file_unreadable`.
pub fn to_csv(
    link: &LinkHistory,
    anchor: Option<ClockAnchor>,
    stream: ExportStream,
    path: &Path,
) -> Result<usize> {
    let name = path.display().to_string();
    let rows: Vec<Row> = link
        .boots
        .iter()
        .flat_map(|boot| rows(boot, anchor, stream))
        .collect();
    if rows.is_empty() {
        return Err(HostError::new(
            ErrorCode::NoRows,
            format!("the {} link carried no such samples", link.role),
            "export another stream or the other link, or switch the stream on with `wimu settings set`",
        ));
    }
    let file = File::create(path).map_err(|error| HostError::file(&name, "create", &error))?;
    let mut writer = CsvWriter::new(BufWriter::new(file), &name, header(stream))?;
    for row in &rows {
        writer.write(row)?;
    }
    writer.finish()?;
    Ok(rows.len())
}

fn header(stream: ExportStream) -> Header {
    let samples = |acceleration_unit| Header {
        time: true,
        accelerometers: vec![None],
        acceleration_unit,
        magnetometer: true,
        temperature: true,
        other: vec!["Sequence".to_owned()],
    };
    match stream {
        ExportStream::Raw => samples(AccelerationUnit::Lsb),
        ExportStream::Corrected => Header {
            other: vec!["Sequence".to_owned(), FIELD_CALIBRATED.to_owned()],
            ..samples(AccelerationUnit::Mps2)
        },
        ExportStream::Navigation => Header {
            accelerometers: Vec::new(),
            magnetometer: false,
            temperature: false,
            other: [
                "Position E (m)",
                "Position N (m)",
                "Position U (m)",
                "Velocity E (m/s)",
                "Velocity N (m/s)",
                "Velocity U (m/s)",
                "Since Rest (s)",
                "Valid",
                HEADING_SD,
                "Sequence",
            ]
            .map(str::to_owned)
            .to_vec(),
            ..samples(AccelerationUnit::Mps2)
        },
    }
}

fn rows(boot: &Boot, anchor: Option<ClockAnchor>, stream: ExportStream) -> Vec<Row> {
    let time_ns = |time: DeviceTimeUs| {
        let utc = anchor
            .zip(boot.host_ns(time))
            .map(|(anchor, host_ns)| anchor.to_utc_ns(host_ns));
        i64::try_from(utc.unwrap_or(time.0.saturating_mul(1000))).ok()
    };
    let mut slow = boot.environment.iter().peekable();
    let mut temperature_c = None;
    let mut field_ut = None;
    let mut field_calibrated = false;
    let mut row = |time: DeviceTimeUs, sequence: u32, value: [f64; 3]| {
        while let Some(next) = slow.next_if(|next| next.time_us <= time.0) {
            temperature_c = next
                .temperature_centi_c
                .map(|centi| f64::from(centi) / 100.0);
            let corrected = match stream {
                ExportStream::Corrected => boot.corrected_field_nt(next),
                _ => None,
            };
            field_calibrated = corrected.is_some();
            field_ut = corrected
                .or_else(|| Some(next.magnetic_field_nt?.map(f64::from)))
                .map(|nt| nt.map(|axis| axis / 1000.0));
        }
        let mut other = vec![sequence.to_string()];
        if stream == ExportStream::Corrected {
            other.push(u8::from(field_calibrated).to_string());
        }
        Row {
            time_ns: time_ns(time),
            accelerations: vec![value],
            magnetic_field_ut: field_ut,
            temperature_c,
            other,
            ..Row::default()
        }
    };
    match stream {
        ExportStream::Raw => boot
            .raw
            .iter()
            .map(|sample| row(sample.time, sample.sequence, sample.value.map(f64::from)))
            .collect(),
        ExportStream::Corrected => boot
            .corrected
            .iter()
            .map(|sample| {
                let force = SpecificForceQ16(sample.value).to_mps2();
                row(sample.time, sample.sequence, force.0)
            })
            .collect(),
        ExportStream::Navigation => boot
            .navigation
            .iter()
            .map(|navigation| {
                let metres = |nm: [i64; 3]| nm.map(|nm| (nm as f64 * 1e-9).to_string());
                let mut other = metres(navigation.position_nm).to_vec();
                other.extend(metres(navigation.velocity_nmps));
                other.push((f64::from(navigation.since_rest_ms) / 1000.0).to_string());
                other.push(u8::from(navigation.flags == 0).to_string());
                let heading_sd = navigation
                    .heading_sd_mrad
                    .map(|mrad| f64::from(mrad) * 1e-3);
                other
                    .push(heading_sd.map_or(String::new(), |sd| format!("{:.2}", sd.to_degrees())));
                other.push(navigation.sequence.to_string());
                Row {
                    time_ns: boot.time_of(navigation.sequence).and_then(time_ns),
                    other,
                    ..Row::default()
                }
            })
            .collect(),
    }
}
