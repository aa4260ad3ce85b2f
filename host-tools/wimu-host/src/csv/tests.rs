use std::path::PathBuf;

use proptest::prelude::*;

use super::*;

fn read(text: &str) -> Result<Vec<Row>> {
    CsvReader::new(text.as_bytes(), "a.csv")?.collect()
}

const XYZ: &str = "Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)";

#[test]
fn every_unit_is_converted() {
    for (unit, ns) in [
        ("s", 1_500_000_000),
        ("ms", 1_500_000),
        ("us", 1_500),
        ("\u{b5}s", 1_500),
        ("\u{3bc}s", 1_500),
        ("ns", 2),
    ] {
        let rows = read(&format!("Time ({unit})\n1.5\n")).unwrap();
        assert_eq!(rows[0].time_ns, Some(ns), "{unit}");
    }
    for (unit, expected) in [
        ("LSB", AccelerationUnit::Lsb),
        ("g", AccelerationUnit::G),
        ("m/s²", AccelerationUnit::Mps2),
        ("m/s2", AccelerationUnit::Mps2),
        ("m/s^2", AccelerationUnit::Mps2),
    ] {
        let text = XYZ.replace("(g)", &format!("({unit})"));
        let reader = CsvReader::new(text.as_bytes(), "a.csv").unwrap();
        assert_eq!(reader.header().acceleration_unit, expected);
    }
    for (unit, ut) in [
        ("\u{b5}T", 2.0),
        ("\u{3bc}T", 2.0),
        ("uT", 2.0),
        ("T", 2e6),
        ("G", 200.0),
    ] {
        let text = format!(
            "Magnetometer X ({unit}),Magnetometer Y ({unit}),Magnetometer Z ({unit})\n2,2,2\n"
        );
        assert_eq!(read(&text).unwrap()[0].magnetic_field_ut, Some([ut; 3]));
    }
    for unit in ["°C", "C"] {
        let rows = read(&format!("Temperature ({unit})\n-3.25\n")).unwrap();
        assert_eq!(rows[0].temperature_c, Some(-3.25));
    }
}

#[test]
fn order_bom_crlf_quotes_and_other_columns_do_not_matter() {
    let text = "\u{feff}Run,Accelerometer Z (LSB),\"Time (s)\",Accelerometer X (LSB),Gyroscope X (dps),Accelerometer Y (LSB),\r\n\
                \"2\",3,0.25,1,9.5,2,\r\n\r\n7,6,0.25,4,,5,\r\n";
    let mut reader = CsvReader::new(text.as_bytes(), "a.csv").unwrap();
    assert_eq!(reader.header().other, ["Run", "Gyroscope X (dps)", ""]);
    let row = reader.next_row().unwrap().unwrap();
    assert_eq!(row.accelerations, [[1.0, 2.0, 3.0]]);
    assert_eq!(row.time_ns, Some(250_000_000));
    assert_eq!(row.other, ["2", "9.5", ""]);
    let row = reader.next_row().unwrap().unwrap();
    assert_eq!((row.line, row.accelerations[0]), (4, [4.0, 5.0, 6.0]));
    assert_eq!(reader.next_row().unwrap(), None);
}

#[test]
fn several_accelerometers_keep_their_numbers() {
    let text = "Accelerometer 1 X (LSB),Accelerometer 1 Y (LSB),Accelerometer 1 Z (LSB),\
                Accelerometer 0 X (LSB),Accelerometer 0 Y (LSB),Accelerometer 0 Z (LSB)\n1,2,3,4,5,6\n";
    let mut reader = CsvReader::new(text.as_bytes(), "a.csv").unwrap();
    assert_eq!(reader.header().accelerometers, [Some(1), Some(0)]);
    let row = reader.next_row().unwrap().unwrap();
    assert_eq!(row.accelerations, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
}

#[test]
fn a_filter_compares_numbers_as_numbers() {
    let text = format!("Time (s),Run,IMU,{XYZ}\n5,1,0,1,1,1\n6,2.0,a,2,2,2\n0,2,b,oops,3,3\n");
    let select = |filter: &str| {
        CsvReader::new(text.as_bytes(), "a.csv")?
            .select(&filter.parse()?)?
            .collect::<Result<Vec<_>>>()
    };
    let rows = select("Run=2, IMU=a").unwrap();
    assert_eq!(rows.len(), 1);
    assert_eq!(rows[0].line, 3);
    assert_eq!(select("time=5").unwrap().len(), 1);
    assert!(select("Run=3").unwrap().is_empty());
    let error = select("Section=x").unwrap_err();
    assert_eq!(error.code(), ErrorCode::CsvMissingColumn);
    assert!(error.remedy().contains("Run, IMU"), "{error}");
    assert_eq!(select("Run").unwrap_err().code(), ErrorCode::Usage);
}

#[test]
fn bad_input_says_which_line_and_column() {
    for (text, code, location, part) in [
        ("", ErrorCode::CsvEmpty, "a.csv", "empty"),
        (
            "\"a\nb\",c\n",
            ErrorCode::CsvFieldCount,
            "a.csv line 1",
            "quoted field",
        ),
        (
            "Time (s),Run\r\n\r\n1,\"2\"3\r\n",
            ErrorCode::CsvFieldCount,
            "a.csv line 3",
            "quoted field",
        ),
        ("\n\n", ErrorCode::CsvEmpty, "a.csv", "empty"),
        (
            "Time (s)|Accelerometer X (g)\n0|1\n",
            ErrorCode::CsvNoHeader,
            "a.csv line 1",
            "'|'",
        ),
        (
            "1,2,3\n4,5,6\n",
            ErrorCode::CsvNoHeader,
            "a.csv line 1",
            "column names",
        ),
        (
            "Accelerometer X (g),Accelerometer Z (g)\n",
            ErrorCode::CsvMissingColumn,
            "a.csv line 1",
            "`Accelerometer Y (g)`",
        ),
        (
            "Accelerometer 3 Y (LSB)\n",
            ErrorCode::CsvMissingColumn,
            "a.csv line 1",
            "`Accelerometer 3 X (LSB)`",
        ),
        (
            "Magnetometer X (uT)\n",
            ErrorCode::CsvMissingColumn,
            "a.csv line 1",
            "`Magnetometer Y",
        ),
        (
            "Accelerometer X (g),Accelerometer Y (m/s²),Accelerometer Z (g)\n",
            ErrorCode::CsvMixedUnits,
            "a.csv line 1, column `Accelerometer Y (m/s²)`",
            "`Accelerometer X (g)`",
        ),
        (
            "Magnetometer X (T),Magnetometer Y (G),Magnetometer Z (T)\n",
            ErrorCode::CsvMixedUnits,
            "a.csv line 1, column `Magnetometer Y (G)`",
            "differs",
        ),
        (
            "Time (h)\n",
            ErrorCode::CsvUnknownUnit,
            "a.csv line 1, column `Time (h)`",
            "`h`",
        ),
        (
            "Temperature\n",
            ErrorCode::CsvUnknownUnit,
            "a.csv line 1, column `Temperature`",
            "missing",
        ),
        (
            "Time (s),time (ms)\n",
            ErrorCode::CsvDuplicateColumn,
            "a.csv line 1, column `time (ms)`",
            "twice",
        ),
        (
            "Run,Run\n",
            ErrorCode::CsvDuplicateColumn,
            "a.csv line 1, column `Run`",
            "twice",
        ),
        (
            "Time (s)\n1\nsoon\n",
            ErrorCode::CsvBadNumber,
            "a.csv line 3, column `Time (s)`",
            "`soon`",
        ),
        (
            "Time (s)\n1e300\n",
            ErrorCode::CsvBadNumber,
            "a.csv line 2, column `Time (s)`",
            "64 bits",
        ),
        (
            "Temperature (C)\nNaN\n",
            ErrorCode::CsvBadNumber,
            "a.csv line 2, column `Temperature (C)`",
            "`NaN`",
        ),
        (
            "Temperature (C)\n-inf\n",
            ErrorCode::CsvBadNumber,
            "a.csv line 2, column `Temperature (C)`",
            "`-inf`",
        ),
        (
            "Time (s),Run\n1,2\n3\n",
            ErrorCode::CsvFieldCount,
            "a.csv line 3",
            "1 fields",
        ),
        (
            "Time (s),Run\n1,2,3\n",
            ErrorCode::CsvFieldCount,
            "a.csv line 2",
            "3 fields",
        ),
        (
            "Time (s)\n1\n2\n1.5\n",
            ErrorCode::CsvTimeBackwards,
            "a.csv line 4",
            "0.5 s after line 3",
        ),
        (
            "Magnetometer X (T),Magnetometer Y (T),Magnetometer Z (T)\n1,,1\n",
            ErrorCode::CsvBadNumber,
            "a.csv line 2",
            "others are not",
        ),
    ] {
        let error = read(text).unwrap_err();
        assert_eq!(error.code(), code, "{text:?}: {error}");
        assert_eq!(error.location(), Some(location), "{text:?}: {error}");
        assert!(error.message().contains(part), "{text:?}: {error}");
        assert_eq!(error.exit_code(), 2);
    }
    let error = read(&format!("{XYZ}\n1,,3\n")).unwrap_err();
    assert_eq!(error.code(), ErrorCode::CsvBadNumber);
    assert_eq!(
        error.location(),
        Some("a.csv line 2, column `Accelerometer Y (g)`")
    );
    let error = CsvReader::new(&b"Time (s),R\xffn\n"[..], "a.csv")
        .err()
        .unwrap();
    assert_eq!(error.code(), ErrorCode::CsvNotUtf8);
}

#[test]
fn repeated_times_pass_and_any_order_can_be_asked_for() {
    assert_eq!(read("Time (s)\n1\n1\n2\n").unwrap().len(), 3);
    let reader = CsvReader::new("Time (s)\n2\n1\n".as_bytes(), "a.csv").unwrap();
    assert_eq!(reader.in_any_order().filter(Result::is_ok).count(), 2);
}

#[test]
fn a_bad_row_does_not_end_the_file() {
    let mut reader = CsvReader::new("Time (s)\n1\nx\n3\n".as_bytes(), "a.csv").unwrap();
    assert!(reader.next_row().is_ok());
    assert!(reader.next_row().is_err());
    assert_eq!(
        reader.next_row().unwrap().unwrap().time_ns,
        Some(3_000_000_000)
    );
}

proptest! {
    #[test]
    fn what_is_written_reads_back_the_same(
        sensors in 1..3_usize,
        mut times in prop::collection::vec(any::<i64>(), 1..20),
        values in prop::collection::vec(prop::num::f64::NORMAL | prop::num::f64::ZERO, 24),
        text in "[a-z,\" µ]{0,8}",
        has_field: bool,
    ) {
        times.sort_unstable();
        let header = Header {
            time: true,
            accelerometers: (0..sensors as u32).map(Some).collect(),
            acceleration_unit: AccelerationUnit::Lsb,
            magnetometer: true,
            temperature: true,
            other: vec!["Note".to_owned()],
        };
        let axes = |at: usize| [values[at], values[at + 1], values[at + 2]];
        let rows: Vec<Row> = times
            .iter()
            .map(|time| Row {
                line: 0,
                time_ns: Some(*time),
                accelerations: (0..sensors).map(|s| axes(3 * s)).collect(),
                magnetic_field_ut: has_field.then(|| axes(9)),
                temperature_c: has_field.then_some(values[12]),
                other: vec![text.trim().to_owned()],
            })
            .collect();
        let mut bytes = Vec::new();
        let mut writer = CsvWriter::new(&mut bytes, "a.csv", header.clone()).unwrap();
        for row in &rows {
            writer.write(row).unwrap();
        }
        writer.finish().unwrap();
        let mut reader = CsvReader::new(&bytes[..], "a.csv").unwrap();
        prop_assert_eq!(reader.header(), &header);
        for row in rows {
            let read = reader.next_row().unwrap().unwrap();
            prop_assert_eq!(Row { line: 0, ..read }, row);
        }
    }

    #[test]
    fn no_bytes_panic(bytes: Vec<u8>, header in "[A-Za-z0-9 (),²/\"]{0,80}") {
        let mut text = header.into_bytes();
        text.push(b'\n');
        text.extend(bytes);
        if let Ok(reader) = CsvReader::new(&text[..], "a.csv") {
            reader.for_each(drop);
        }
    }
}

/// The folder of public recordings beside the checkout, if it is there.
fn recordings() -> Option<PathBuf> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    if folder.is_dir() {
        Some(folder)
    } else {
        println!("skipped: the folder of public recordings, ../shared/data, is absent");
        None
    }
}

#[test]
fn every_public_recording_reads() {
    let Some(data) = recordings() else { return };
    let mut files = 0;
    for folder in [
        "array",
        "calibration",
        "gait",
        "motion",
        "protractor",
        "static",
    ] {
        for file in data.join(folder).read_dir().into_iter().flatten() {
            let path = file.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            // Lever arms and a list of trials are no sensor data.
            let other = ["mimu4444_positions.csv", "pyshoe_trials.csv"];
            if !name.ends_with(".csv") || other.contains(&name.as_str()) {
                continue;
            }
            let mut reader = CsvReader::open(&path).unwrap();
            if name == "mpu9150_array_pose_means.csv" {
                reader = reader.select(&"Run=2,IMU=0".parse().unwrap()).unwrap();
            }
            let text = std::fs::read_to_string(&path).unwrap();
            let expected = match name.as_str() {
                "mpu9150_array_pose_means.csv" => {
                    text.lines().filter(|l| l.starts_with("2,0,")).count()
                }
                _ => text.lines().count() - 1,
            };
            let rows = reader.collect::<Result<Vec<_>>>().unwrap().len();
            assert_eq!(rows, expected, "{name}");
            files += 1;
        }
    }
    assert!(files >= 15, "only {files} files found");
}

/// A header of three axes made of one name.
fn axes(name: &str, separator: &str) -> String {
    ["x", "y", "z"]
        .map(|axis| name.replace('#', axis))
        .join(separator)
}

#[test]
fn other_programs_names_are_read_where_they_leave_no_doubt() {
    use AccelerationUnit::{G, Lsb, Mps2};
    for (name, unit, value) in [
        ("Acceleration # (m/s^2)", Mps2, 9.5),
        ("acc_# [g]", G, 9.5),
        ("Accel# (g)", G, 9.5),
        ("Accel_# (mg)", G, 0.0095),
        ("a# (m/s²)", Mps2, 9.5),
        ("ACC # [m/s/s]", Mps2, 9.5),
        ("Accelerometer_# (counts)", Lsb, 9.5),
        ("Accelerometer # [LSB]", Lsb, 9.5),
    ] {
        let text = format!("Timestamp (ms),{}\n1,0,0,9.5\n", axes(name, ","));
        let reader = CsvReader::new(text.as_bytes(), "a.csv").unwrap();
        assert_eq!(reader.header().acceleration_unit, unit, "{name}");
        let rows = read(&text).unwrap();
        assert_eq!(rows[0].accelerations, [[0.0, 0.0, value]], "{name}");
        assert_eq!(rows[0].time_ns, Some(1_000_000), "{name}");
    }
    let text = format!("{}\n1,2,3\n", axes("Magnetic field # (µT)", ","));
    assert_eq!(
        read(&text).unwrap()[0].magnetic_field_ut,
        Some([1.0, 2.0, 3.0])
    );
    assert_eq!(
        read("Temp [°C]\n21\n").unwrap()[0].temperature_c,
        Some(21.0)
    );

    // Without gravity, without a unit, in a unit nobody knows, or beside columns of ours: not taken.
    for name in [
        "Linear Acceleration # (m/s^2)",
        "acc_#",
        "ax_# (g)",
        "Accel # (raw)",
        "Gyroscope # (rad/s)",
    ] {
        let text = format!("{}\n1,2,3\n", axes(name, ","));
        let reader = CsvReader::new(text.as_bytes(), "a.csv").unwrap();
        assert_eq!(reader.header().accelerometers, [], "{name}");
        assert_eq!(reader.header().other.len(), 3, "{name}");
    }
    let both = format!(
        "Time (s),t (s),{XYZ},{}\n5,6,1,2,3,4,5,6\n",
        axes("acc_# (mg)", ",")
    );
    let rows = read(&both).unwrap();
    assert_eq!(
        (rows[0].time_ns, &rows[0].accelerations[..]),
        (Some(5_000_000_000), &[[1.0, 2.0, 3.0]][..])
    );
    assert_eq!(rows[0].other, ["6", "4", "5", "6"]);

    // Two of the same kind leave a doubt.
    let twice = format!(
        "{},{}\n",
        axes("acc_# (g)", ","),
        axes("Acceleration # (m/s^2)", ",")
    );
    let error = read(&twice).unwrap_err();
    assert_eq!(error.code(), ErrorCode::CsvMixedUnits);
    let twice = format!(
        "{},{}\n",
        axes("acc_# (g)", ","),
        axes("Acceleration # (g)", ",")
    );
    assert_eq!(
        read(&twice).unwrap_err().code(),
        ErrorCode::CsvDuplicateColumn
    );
    let error = read("t (s),Timestamp (ms)\n").unwrap_err();
    assert_eq!(error.code(), ErrorCode::CsvDuplicateColumn);
}

#[test]
fn semicolons_tabs_decimal_commas_and_comments_are_read() {
    let expected = [[0.5, -1.0, 9.807]];
    for (separator, mark) in [(";", ","), (";", "."), ("\t", ","), ("\t", "."), (",", ".")] {
        let names = axes("\"Acceleration # (m/s^2)\"", separator);
        let row = ["0.25E0", "0.5", "-1", "9.807", ""]
            .join(separator)
            .replace('.', mark);
        let text =
            format!("# made by hand\n\"Time (s)\"{separator}{names}{separator}Note\n#\n{row}\n");
        let rows = read(&text).unwrap();
        assert_eq!(rows[0].accelerations, expected, "{text}");
        assert_eq!(
            (rows[0].time_ns, rows[0].line),
            (Some(250_000_000), 4),
            "{text}"
        );
        assert_eq!(rows[0].other, [""], "{text}");
    }
    // A comma that may be of thousands, two kinds of marks, and both in one number.
    let lsb = axes("Accelerometer # (LSB)", ";");
    let g = axes("Accelerometer # (g)", ";");
    for text in [
        format!("{lsb}\n16,384;0;0\n"),
        format!("{g}\n0,5;0.5;0\n"),
        format!("{g}\n0.5;0;1\n0;0,5;1\n"),
        format!("{g}\n1,000.5;0;0\n"),
    ] {
        let error = read(&text).unwrap_err();
        assert_eq!(error.code(), ErrorCode::CsvBadNumber, "{text}");
        assert!(
            error.location().unwrap().contains("column `Accelerometer"),
            "{error}"
        );
    }
    assert_eq!(
        read(&format!("{lsb}\n1183,25;0;0\n")).unwrap()[0].accelerations[0][0],
        1183.25
    );
}
