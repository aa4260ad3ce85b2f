//! What commands leave behind where the disk is full.
#![cfg(unix)]

use crate::kit;

use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use kit::{folder, noise, spread};

/// Runs `wimu`, whose files cannot grow beyond `limit` blocks of 512 or 1024 bytes.
fn with_files_of(limit: &str, folder: &Path, arguments: &str) -> Output {
    let script = format!(
        "trap '' XFSZ; ulimit -f {limit} && exec '{}' {arguments}",
        env!("CARGO_BIN_EXE_wimu")
    );
    Command::new("sh")
        .args(["-c", &script])
        .current_dir(folder)
        .stdin(Stdio::null())
        .output()
        .expect("a shell")
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn a_full_disk_leaves_the_file_of_before_and_nothing_else() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    let mut poses =
        "Accelerometer X (LSB),Accelerometer Y (LSB),Accelerometer Z (LSB)\n".to_owned();
    for up in spread(20) {
        let [x, y, z] = up.map(|f| 1024.0 * f + 20.0);
        writeln!(poses, "{x},{y},{z}").unwrap();
    }
    fs::write(at("poses.csv"), poses).unwrap();
    let mut noise = noise();
    let mut rest = "Time (s)".to_owned();
    for axis in ["X", "Y", "Z"] {
        write!(rest, ",Accelerometer {axis} (m/s²)").unwrap();
    }
    for k in 0..2000 {
        let [x, y, z] = [0.0, 0.0, 9.80665].map(|f| f + 0.01 * noise());
        write!(rest, "\n{:.2},{x},{y},{z}", f64::from(k) * 0.01).unwrap();
    }
    fs::write(at("rest.csv"), rest).unwrap();
    let calibrated = with_files_of(
        "unlimited",
        folder.path(),
        "calibrate poses.csv --poses --sensitivity 1024 -o cal.json",
    );
    assert!(calibrated.status.success(), "{calibrated:?}");

    let commands = [
        ("calibrate poses.csv --poses -o", "CAL.json"),
        ("calibrate poses.csv --poses --report", "page.html"),
        ("allan rest.csv --report", "page.html"),
        ("navigate rest.csv -o", "path.csv"),
        ("navigate rest.csv --report", "page.html"),
        ("convert cal.json --to c -o", "wimu.h"),
        ("convert cal.json --to kalibr -o", "imu.yaml"),
        // Its recording, demo.mcap, comes first.
        ("demo --report demo.html --pictures", "demo.mcap"),
    ];
    for (command, file) in commands {
        fs::write(at(file), "what stood there").unwrap();
        let before = names(folder.path());
        let arguments = match file {
            "demo.mcap" => command.trim_end_matches(" --pictures").to_owned(),
            _ => format!("{command} {file}"),
        };
        let ran = with_files_of("0", folder.path(), &arguments);
        assert_eq!(ran.status.code(), Some(1), "{arguments}: {ran:?}");
        let text = String::from_utf8_lossy(&ran.stderr);
        assert!(text.contains(&format!("wimu: {file}: ")), "{text}");
        let left = fs::read_to_string(at(file)).unwrap();
        assert_eq!(left, "what stood there", "{arguments}");
        assert_eq!(names(folder.path()), before, "{arguments}");
        // With space it is replaced.
        if file != "demo.mcap" {
            let ran = with_files_of("unlimited", folder.path(), &arguments);
            assert!(ran.status.success(), "{arguments}: {ran:?}");
            assert_ne!(fs::read_to_string(at(file)).unwrap(), "what stood there");
            assert_eq!(names(folder.path()), before, "{arguments}");
        }
    }
}
