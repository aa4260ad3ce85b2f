//! Columns of exported tables.

use super::ExportStream;
use crate::csv::{AccelerationUnit, Header, SENSITIVITY};
use crate::motion::FIELD_CALIBRATED;

/// The column with the standard deviation of the heading, empty where it is uncalibrated.
const HEADING_SD: &str = "Heading SD (deg)";
/// The column with the nominal scale of a gyroscope's counts.
pub const GYROSCOPE_SCALE: &str = "Gyroscope Scale (rad/s/LSB)";

/// The axes of a gyroscope.
pub fn gyroscope(unit: &str) -> impl Iterator<Item = String> + '_ {
    ["X", "Y", "Z"]
        .into_iter()
        .map(move |axis| format!("Gyroscope {axis} ({unit})"))
}

/// The header of a table.
pub fn header(stream: ExportStream, sensor: u8, has_gyroscope: bool, has_attitude: bool) -> Header {
    let mut other: Vec<String> = Vec::new();
    let mut acceleration_unit = AccelerationUnit::Mps2;
    match stream {
        ExportStream::Raw => {
            acceleration_unit = AccelerationUnit::Lsb;
            other.extend(["Sequence", SENSITIVITY].map(str::to_owned));
            if has_gyroscope {
                other.extend(gyroscope("LSB"));
                other.push(GYROSCOPE_SCALE.to_owned());
            }
        }
        ExportStream::Corrected => {
            other.extend(["Sequence", FIELD_CALIBRATED].map(str::to_owned));
            if has_gyroscope {
                other.extend(gyroscope("rad/s"));
            }
        }
        ExportStream::Navigation => {
            let columns = [
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
            ];
            other.extend(columns.map(str::to_owned));
            if has_attitude {
                other.extend(["W", "X", "Y", "Z"].map(|part| format!("Quaternion {part}")));
            }
        }
    }
    let samples = stream != ExportStream::Navigation;
    let number = (sensor > 0).then_some(sensor.into());
    Header {
        time: true,
        accelerometers: samples.then_some(number).into_iter().collect(),
        acceleration_unit,
        magnetometer: samples,
        temperature: samples,
        other,
    }
}
