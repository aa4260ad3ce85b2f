//! Tables of sensors: columns, units and times.

use wimu_host::formats::{self, ReadOptions, Source};
use wimu_host::recording::{Origin, Quantity, Recording, Track, Unit};
use wimu_host::{Code, Result, Severity};
use wimu_model::STANDARD_GRAVITY_MPS2 as G;

pub fn text(text: &str) -> Result<Recording> {
    named("table.csv", text, &ReadOptions::default())
}

pub fn named(name: &str, text: &str, options: &ReadOptions) -> Result<Recording> {
    let source = Source::of_bytes(name, text.as_bytes());
    let mut recording = Recording::new(name);
    recording.format = formats::read(&source, options, &mut recording)?;
    Ok(recording)
}

pub fn has(recording: &Recording, code: Code) -> bool {
    recording.findings.iter().any(|finding| finding.code == code)
}

#[test]
fn own_tables_keep_every_column() {
    let recording = text(
        "Time (ms),Accelerometer 0 X (LSB),Accelerometer 0 Y (LSB),Accelerometer 0 Z (LSB),Accelerometer 1 X (LSB),\
         Accelerometer 1 Y (LSB),Accelerometer 1 Z (LSB),Sensitivity (LSB/g),Magnetometer X (µT),Magnetometer Y (µT),\
         Magnetometer Z (µT),Temperature (C),Field Calibrated,Truth Position E (m),Truth Position N (m),Truth Position U (m),\
         Truth Quaternion W,Truth Quaternion X,Truth Quaternion Y,Truth Quaternion Z,Note\n\
         0,1,2,256,3,4,255,256,10,0,0,20.5,1,0,0,1,1,0,0,0,start\n\
         10,1,2,256,3,,255,256,,,,,0,,,,,,,,\n\
         20,1,2,512,3,4,511,512,,,,,0,,,,,,,,\n\
         30,1,2,512,3,4,511,,,,,,0,,,,,,,,\n",
    )
    .unwrap();
    let unit = |lsb: f64| Unit::Counts { si_per_lsb: Some(G / lsb) };
    let force: Vec<&Track> = recording.of(Quantity::SpecificForce).collect();
    let of = |k: usize| (force[k].info.sensor, force[k].info.unit, force[k].len());
    assert_eq!(
        [0, 1, 2, 3].map(of),
        [(0, unit(256.0), 2), (1, unit(256.0), 2), (0, unit(512.0), 1), (1, unit(512.0), 1)]
    );
    assert_eq!(force[1].mask(), [true, false]);
    assert_eq!(force[0].info.name, "Accelerometer 0");
    let field = recording.first(Quantity::MagneticField).unwrap();
    assert!((field.row(0).unwrap()[0] - 1e-5).abs() < 1e-18);
    assert_eq!(field.len(), 1);
    assert_eq!(recording.first(Quantity::Temperature).unwrap().row(0), Some(&[20.5][..]));
    let attitude = recording.of(Quantity::Attitude).next().unwrap();
    assert_eq!(
        (attitude.info.origin, attitude.row(0)),
        (Origin::Truth, Some(&[1.0, 0.0, 0.0, 0.0][..]))
    );
    assert_eq!(recording.of(Quantity::Position).next().unwrap().row(0), Some(&[0.0, 0.0, 1.0][..]));
    let scalars: Vec<_> =
        recording.of(Quantity::Scalar).map(|t| (t.info.name.as_str(), t.len())).collect();
    assert_eq!(scalars, [("Sensitivity (LSB/g)", 3), ("Field Calibrated", 4)]);
    let axes =
        text("Time (s),Accelerometer 0 (m/s²),Accelerometer 1 (m/s²)\n0,1,2\n1,1,2\n").unwrap();
    let names: Vec<_> = axes.tracks().iter().map(|t| t.info.name.as_str()).collect();
    assert_eq!(names, ["Accelerometer 0 (m/s²)", "Accelerometer 1 (m/s²)"]);
}

/// Rows of six poses of an accelerometer with this magnitude and output at zero, as text.
fn six_poses(header: &str, magnitude: f64, zero: f64, write: impl Fn(f64) -> String) -> String {
    let mut text = format!("{header}\n");
    let mut time = 0;
    for pose in 0..6 {
        for sample in 0..64 {
            let mut axes = [0.01, -0.02, 0.015].map(|f: f64| f * magnitude);
            axes[pose / 2] = if pose % 2 == 0 { magnitude } else { -magnitude };
            axes[0] += 0.002 * magnitude * f64::from(sample % 5 - 2);
            let fields = axes.map(|value| write(value + zero)).join(",");
            text += &format!("{time},{fields}\n");
            time += 10;
        }
    }
    text
}

fn whole(value: f64) -> String {
    format!("{value:.0}")
}

#[test]
fn unsigned_counts_of_all_widths_are_recognised() {
    for (lsb, zero) in
        [(68.0, 512.0), (400.0, 2048.0), (2048.0, 8192.0), (4096.0, 32768.0), (16384.0, 32768.0)]
    {
        let recording = text(&six_poses("time,ax,ay,az", lsb, zero, whole)).unwrap();
        assert!(has(&recording, Code::ZeroCount), "{lsb} {zero}");
        let first = recording.first(Quantity::SpecificForce).unwrap().row(0).unwrap()[0];
        assert!((first / lsb - 1.0).abs() < 0.02, "{lsb} {zero}: {first}");
    }
    // A signed sensor flat on a table, whose small axes happen to be positive.
    for lsb in [68.0, 256.0, 1000.0, 4096.0, 16384.0] {
        let rows: String = (0..100)
            .map(|k| format!("{},{:.0},{:.0},{:.0}\n", 10 * k, 0.02 * lsb, 0.03 * lsb, lsb))
            .collect();
        let recording = text(&format!("time,ax,ay,az\n{rows}")).unwrap();
        assert!(!has(&recording, Code::ZeroCount), "{lsb}: {:?}", recording.findings);
    }
}

/// Rows of a time and an acceleration of 1 g along z, in g.
fn timed(header: &str, times: [&str; 3]) -> Recording {
    let rows = times.map(|time| format!("{time},0,0.5,1.0\n")).concat();
    text(&format!("{header},ax (g),ay (g),az (g)\n{rows}")).unwrap()
}

#[test]
fn time_columns_are_recognised_by_unit_or_word() {
    for (header, times, step) in [
        ("Time (min)", ["0", "0.5", "1"], 30_000_000_000),
        ("t (minutes)", ["0.00016666667", "0.0003333333", "1"], 10_000_002),
        ("Time (h)", ["0", "0.001", "0.002"], 3_600_000_000),
        ("time_hours", ["100", "100.001", "100.002"], 3_600_000_000),
        ("seconds", ["1", "2", "3"], 1_000_000_000),
        ("sec", ["1.01", "1.02", "1.03"], 10_000_000),
        ("ms", ["10", "20", "30"], 10_000_000),
        ("us", ["10", "20", "30"], 10_000),
        ("unix_timestamp", ["1700000000.5", "1700000000.6", "1700000000.7"], 100_000_000),
        ("unix time", ["1700000000500", "1700000000600", "1700000000700"], 100_000_000),
        ("Accelerometer Timestamp (s)", ["5", "5.01", "5.02"], 10_000_000),
        ("time of sample ms", ["10", "20", "30"], 10_000_000),
        ("hh:mm:ss.fff", ["12:00:01.250", "12:00:01.260", "12:00:01.270"], 10_000_000),
        ("hh:mm:ss(.fff)", ["12:00:01.250", "12:00:01.260", "12:00:01.270"], 10_000_000),
        ("Recording time", ["12:00:01.250", "12:00:01.260", "12:00:01.270"], 10_000_000),
    ] {
        let recording = timed(header, times);
        let found = recording.first(Quantity::SpecificForce).unwrap().times_ns();
        assert!((found[1] - found[0] - step).abs() < 10, "{header}: {found:?}");
        assert!(!has(&recording, Code::Rate), "{header}");
    }
    // The finer of two times is used, parts of a time are added, and a column that does not increase is not a time.
    let table =
        |header: &str, rows: &str| text(&format!("{header},ax_g,ay_g,az_g\n{rows}")).unwrap();
    let better = table("ms,t", "1,5.0,0,0,1\n2,5.5,0,0,1\n");
    let force = better.first(Quantity::SpecificForce).unwrap();
    assert_eq!(force.times_ns()[1], 5_500_000_000);
    let parts = table("sec,usec", "1,999000,0,0,1\n2,4000,0,0,1\n");
    let force = parts.first(Quantity::SpecificForce).unwrap();
    assert_eq!(force.times_ns(), [1_999_000_000, 2_004_000_000]);
    assert!(has(&timed("run time", ["3", "2", "1"]), Code::Rate));
}

#[test]
fn unknown_units_of_times_are_reported() {
    let recording = timed("Time (days)", ["0", "0.1", "0.2"]);
    let finding = recording.findings.iter().find(|finding| finding.text.contains("`days`"));
    let finding = finding.unwrap();
    assert_eq!(finding.severity, Severity::Warning);
    assert!(finding.remedy.contains("Time (ms)"), "{finding}");
}

#[test]
fn short_file_names_name_no_quantity() {
    let is_assumed = |name| {
        let text = "t,x,y,z\n0,0.1,0.2,9.8\n1,0.1,0.2,9.8\n";
        let findings = named(name, text, &ReadOptions::default()).unwrap().findings;
        findings.iter().any(|finding| finding.text.contains("taken as acceleration"))
    };
    for name in ["h.csv", "a.csv", "gy.csv"] {
        assert!(is_assumed(name), "{name}");
    }
    assert!(!is_assumed("acc.csv"));
}

#[test]
fn decimal_commas_between_commas_are_refused_with_the_cause() {
    let table = |header: &str, row: &str, rows| text(&format!("{header}\n{}", row.repeat(rows)));
    for rows in [20, 5500] {
        let header = "Time (s),ax (g),ay (g),az (g)";
        let error = table(header, "0,01,0,02,0,03,0,98\n", rows).unwrap_err();
        let message = error.to_string();
        assert_eq!(error.code, Code::BadRecording, "{message}");
        assert!(message.contains("decimal commas"), "{message}");
        assert!(error.remedy.contains("semicolons"), "{message}");
        assert_eq!(message.contains("1000 of the first 1000 rows"), rows > 1000, "{message}");
    }
    // The halves of numbers are not read as columns without a header.
    let error = table("x,y,z", "0,02,0,03,0,98\n", 20).unwrap_err();
    assert_eq!(error.code, Code::BadRecording, "{error}");
}

#[test]
fn times_are_exact() {
    let ns = |header, rows: &[&str]| -> Vec<i64> {
        let rows: String = rows.iter().map(|row| format!("{row},0,0.5,1.0\n")).collect();
        let table = text(&format!("{header},ax (g),ay (g),az (g)\n{rows}")).unwrap();
        table.first(Quantity::SpecificForce).unwrap().times_ns().to_vec()
    };
    let noon = 1_574_080_245_120_000_000;
    for (header, row, next, expected) in [
        ("time", "2011-09-26 13:02:25.964389445", "2011-09-26 13:02:26", 1_317_042_145_964_389_445),
        (
            "time",
            "2019-11-18 12:30:45.120 +0200",
            "2019-11-18 12:30:46 +0200",
            noon - 7_200_000_000_000,
        ),
        ("time", "2019-11-18T10:30:45.12-02:00", "2019-11-18T10:30:46-02:00", noon),
        ("date,time", "11/18/2019,12:30:45.12", "11/18/2019,12:30:46", noon),
        ("Time (s)", "1795222920.123456789", "1795222921", 1_795_222_920_123_456_789),
        ("Time (s)", "-0.0000000005", "1", -1),
        ("Time (s)", "1e-3", "2.5E+1", 1_000_000),
        ("Time (ms)", "0.07829", "5.", 78_290),
    ] {
        assert_eq!(ns(header, &[row, next])[0], expected, "{row}");
    }
    // Clocks of a day and of 32 bits go on where they begin again.
    let midnight = ns("hh:mm:ss", &["23:59:59.5", "00:00:00.5", "00:00:01.5"]);
    assert_eq!(midnight[1] - midnight[0], 1_000_000_000);
    let wrapped = ns("Time (us)", &["4294957296", "4294967291", "9995", "19990"]);
    assert_eq!([1, 2, 3].map(|k| wrapped[k] - wrapped[k - 1]), [9_995_000, 10_000_000, 9_995_000]);
}

#[test]
fn extreme_times_do_no_harm_and_times_without_an_order_are_refused() {
    let rows = |time: &dyn Fn(usize) -> i64| -> String {
        (0..300).map(|k| format!("{},0,{},1\n", time(k), k % 7)).collect()
    };
    let read = |rows: String| text(&format!("Time (ns),ax (g),ay (g),az (g)\n{rows}"));
    let ends = [i64::MIN, i64::MAX, 0, -1, i64::MAX - 5, i64::MIN + 7];
    if let Err(error) = read(rows(&|k| ends[k * k % 6])) {
        assert_eq!(error.code, Code::DataRefused, "{error}");
    }
    let error = read(rows(&|k| 1000 * (k * 7919 % 300) as i64)).unwrap_err();
    assert_eq!(error.code, Code::DataRefused, "{error}");
}
