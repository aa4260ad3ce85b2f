//! Detection of files of other programs, and how to convert them to CSV.

use crate::{ErrorCode, HostError};

/// First bytes, name, and conversion to CSV.
#[rustfmt::skip]
const FORMATS: [(&[u8], &str, &str); 14] = [
    (b"PK\x03\x04", "a ZIP archive or a spreadsheet", "unpack it, or save it as CSV (UTF-8)"),
    (b"\x1f\x8b", "compressed by gzip", "unpack it: `gunzip FILE`"),
    (b"\x28\xb5\x2f\xfd", "compressed by zstd", "unpack it: `zstd -d FILE`"),
    (b"\x04\x22\x4d\x18", "compressed by lz4", "unpack it: `lz4 -d FILE`"),
    (b"BZh", "compressed by bzip2", "unpack it: `bunzip2 FILE`"),
    (b"\xfd7zXZ\0", "compressed by xz", "unpack it: `unxz FILE`"),
    (b"PAR1", "a Parquet file", "in Python: `pandas.read_parquet(FILE).to_csv(CSV)`"),
    (b"#ROSBAG V", "a ROS 1 bag", "`rostopic echo -b FILE -p IMU_TOPIC > CSV`"),
    (b"SQLite format 3\0", "a ROS 2 bag (.db3) or a database", "export its Imu topic as CSV"),
    (b"MATLAB ", "a MATLAB file", "in MATLAB: `writetable(TABLE, CSV)`"),
    (b"\x89HDF\r\n", "an HDF5 file", "in Python, with h5py or pandas: `to_csv(CSV)`"),
    (b"ULog\x01\x12\x35", "a PX4 log (ULog)", "`ulog2csv -m sensor_combined FILE`"),
    (b"\xa3\x95\x80", "an ArduPilot log", "`mavlogdump.py --types IMU --format csv FILE > CSV`"),
    (b"H Product:Blackbox", "a Betaflight log", "`blackbox_decode FILE`"),
];

/// The error for a file that begins with `start`, if it is of another program.
pub(crate) fn refused(start: &[u8]) -> Option<HostError> {
    let (_, name, how) = FORMATS
        .iter()
        .find(|(magic, ..)| start.starts_with(magic))?;
    Some(ErrorCode::UnknownFormat.error(
        format!("this is {name}, not a CSV file"),
        format!("{how}; then name the columns `Time (s),Accelerometer X (m/s²),…`"),
    ))
}
