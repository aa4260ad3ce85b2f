//! Formats that wimu recognises but does not read: a refusal names the export that works.

use super::{ReadOptions, Source};
use crate::recording::Sink;
use crate::{Code, Result};

/// First bytes, name, and what to do.
const FILES: [(&[u8], &str, &str); 11] = [
    (b"\x28\xb5\x2f\xfd", "compressed by zstd", "unpack it: zstd -d FILE"),
    (b"\x04\x22\x4d\x18", "compressed by lz4", "unpack it: lz4 -d FILE"),
    (b"BZh", "compressed by bzip2", "unpack it: bunzip2 FILE"),
    (b"\xfd7zXZ\0", "compressed by xz", "unpack it: unxz FILE"),
    (b"\x89HDF\r\n", "an HDF5 file", "write it as CSV, for example in Python with h5py or pandas"),
    (
        b"PAR1",
        "Apache Parquet",
        "write it as CSV, for example pandas.read_parquet(FILE).to_csv(\"OUT.csv\", index=False)",
    ),
    (
        b"MATLAB 5.0 MAT-file",
        "a MATLAB MAT-file",
        "write it as CSV in MATLAB: writetimetable(T, \"OUT.csv\") or writetable(T, \"OUT.csv\")",
    ),
    (
        b"MATLAB 7.3 MAT-file",
        "a MATLAB MAT-file",
        "write it as CSV in MATLAB: writetimetable(T, \"OUT.csv\") or writetable(T, \"OUT.csv\")",
    ),
    // The data logger's first message is the response to a ping (x-IMU3 User Manual, 7.3).
    (
        b"{\"ping\":",
        "an x-IMU3 data logger file",
        "convert it to CSV with the x-IMU3 GUI and read its Inertial.csv",
    ),
    (b"MD\xfc\x03", "an Axivity .cwa file", "export it as CSV with raw samples in OmGui"),
    (
        b"Device Identity",
        "a GENEActiv .bin file",
        "export it as CSV in the GENEActiv software, without epochs",
    ),
];

/// A member of an archive, name, and what to do.
const ARCHIVES: [(&str, &str, &str); 2] = [
    ("xl/workbook", "an Excel workbook", "save its sheet as CSV (UTF-8)"),
    ("log.bin", "an ActiGraph .gt3x file", "export it in ActiLife as RAW CSV"),
];

/// The name and the remedy of a source's format.
fn named(source: &Source) -> Option<(&'static str, &'static str)> {
    let has = |part: &str| source.members().iter().any(|member| member.name().contains(part));
    let archive = ARCHIVES.iter().find(|(member, ..)| has(member));
    let file = FILES.iter().find(|(magic, ..)| source.start().starts_with(magic));
    let archive = archive.map(|(_, name, remedy)| (*name, *remedy));
    archive.or_else(|| file.map(|(_, name, remedy)| (*name, *remedy)))
}

/// Whether it is one of them.
pub(super) fn detect(source: &Source) -> bool {
    named(source).is_some()
}

/// Refuses it.
pub(super) fn read(source: &Source, _: &ReadOptions, _: &mut dyn Sink) -> Result<()> {
    let (name, remedy) =
        named(source).unwrap_or(("no known format", "see docs/reference/formats.md"));
    let message = format!("this is {name}, which wimu does not read");
    Err(Code::UnknownFormat.error(message, remedy).at(source.name()))
}
