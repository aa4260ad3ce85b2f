//! Relations between options that depend on a value or on the kind of input; clap declares all others.

use std::path::{Path, PathBuf};

use clap::parser::ValueSource;
use clap::{ArgMatches, CommandFactory};
use wimu_host::{Input, Result};

use super::{Arguments, Command, Method, Setup};
use crate::output::usage;

/// Which options of a command go with which value of another option. Options without a row go with all of them.
struct Table {
    command: &'static str,
    decided_by: &'static str,
    values: &'static [&'static str],
    /// An option, and one mark for each of `values`: × goes with it, · does not.
    rows: &'static [(&'static str, &'static str)],
}

#[rustfmt::skip]
const TABLES: [Table; 2] = [
    Table {
        command: "calibrate",
        decided_by: "method",
        values: &["multi-position", "six-position", "four-angle", "three-angle", "reference", "update", "magnetometer"],
        rows: &[
            ("model",                 "× × × × · · ·"),
            ("chip",                  "× × × × · · ·"),
            ("gravity",               "× × × × · × ·"),
            ("latitude",              "× × × × · · ·"),
            ("sensitivity",           "× × × × × · ·"),
            ("range",                 "× × × × × · ·"),
            ("target",                "× × × × · · ·"),
            ("placement-sd",          "· × × × · · ·"),
            ("sides",                 "· × · · · · ·"),
            ("reference",             "· · · · × · ·"),
            ("with",                  "· · · · · × ×"),
            ("dip",                   "· · · · · · ×"),
            ("poses",                 "× × × × · × ×"),
            ("topic",                 "× × × × · × ×"),
            ("report",                "× × × × × × ×"),
            ("count",                 "× × × × · · ×"),
            ("push",                  "× × × × · · ×"),
        ],
    },
    // A replayed CSV file has no angular rates.
    Table {
        command: "simulate",
        decided_by: "chip",
        values: &["lsm303agr", "adxl345", "lsm6dso", "lsm6ds3tr-c", "mpu6050", "icm42688"],
        rows: &[
            ("replay",                "× × · · · ·"),
        ],
    },
];

/// What is read by its format.
const TABLE: &str = "a table or a recording of another program";

/// What is complete.
const FILE: &str = "a file";

/// The topics of a recording of wimu.
const LINKS: [&str; 2] = ["cable", "wireless"];

/// Options of `align`, `allan`, `calibrate`, `info` and `navigate` that one kind of input has.
const INPUTS: [(&str, &str); 18] = [
    ("where", TABLE),
    ("format", TABLE),
    ("poses", TABLE),
    ("sensor", TABLE),
    ("range", TABLE),
    ("topic", TABLE),
    ("columns", TABLE),
    ("units", TABLE),
    ("count", "a LINK"),
    ("for", "a LINK"),
    ("push", "a LINK"),
    ("rate", TABLE),
    ("updates", "a LINK"),
    ("rests", FILE),
    ("smooth", FILE),
    ("loop", FILE),
    ("odometry", FILE),
    ("survey_m", FILE),
];

/// Options and keys of the setup of `navigate` that exclude each other.
const EXCLUDE: [(&str, &[&str]); 4] = [
    (
        "geometry",
        &[
            "anchors",
            "fixes",
            "full_scales_g",
            "loop",
            "odometry",
            "profile",
            "relative",
            "rests",
            "smooth",
            "start",
            "within",
        ],
    ),
    ("anchors", &["fixes", "full_scales_g", "loop", "relative", "rests"]),
    ("relative", &["fixes", "full_scales_g", "loop", "rests", "start", "within", "zupt"]),
    ("ranges", &["odometry"]),
];

/// Those that need another.
const NEED: [(&str, &[&str]); 8] = [
    ("ranges", &["anchors"]),
    ("range_errors", &["anchors"]),
    ("survey_m", &["anchors"]),
    ("fix_delay_s", &["fixes", "ranges"]),
    ("fix_time_sd_s", &["fixes", "ranges"]),
    ("place_sd_mm", &["geometry"]),
    ("delay_sd_us", &["geometry"]),
    ("hinge", &["relative"]),
];

/// Options of `navigate` that ranges beside a board have, and those of a recording do not.
const BESIDE_A_BOARD: [&str; 3] = ["zupt", "within", "profile"];

/// Ends of file names for which people expect formats that no command writes.
const OTHER_FORMATS: [&str; 7] = ["bag", "db3", "mat", "pdf", "png", "xls", "xlsx"];

/// Arguments that name files to read.
const INPUT_FILES: [&str; 10] = [
    "input", "more", "boards", "other", "fixes", "ranges", "odometry", "camera", "noise", "replay",
];

/// Refuses options that the command would ignore, and an output file that is an input.
///
/// # Errors
/// `usage`, with the option, what it needs and what was given.
pub fn check(matches: &ArgMatches, parsed: &Command) -> Result<()> {
    let Some((name, matches)) = matches.subcommand() else {
        return Ok(());
    };
    let command = Arguments::command();
    let Some(command) = command.find_subcommand(name) else {
        return Ok(());
    };
    let mut given: Vec<&str> = command
        .get_arguments()
        .filter(|option| {
            matches.value_source(option.get_id().as_str()) == Some(ValueSource::CommandLine)
        })
        .filter_map(|option| option.get_long())
        .collect();
    not_over_input(name, matches, parsed)?;
    if let Command::Navigate(navigate) = parsed {
        given.extend(navigate.aids.setup.given.iter().map(String::as_str));
        of_navigation(&given, !navigate.boards.is_empty())?;
    }
    for table in TABLES.iter().filter(|table| table.command == name) {
        by_value(table, matches, &given)?;
    }
    if matches!(name, "align" | "allan" | "calibrate" | "info" | "navigate")
        && !given.contains(&"geometry")
        && (name != "calibrate" || !given.contains(&"setup"))
        && !given.contains(&"print-setup")
    {
        by_input(matches, &given)?;
        if name == "calibrate" {
            several(matches)?;
        }
    }
    Ok(())
}

/// Refuses an output file that is an input.
fn not_over_input(name: &str, matches: &ArgMatches, parsed: &Command) -> Result<()> {
    let files = |ids: &[&str]| -> Vec<PathBuf> {
        let raw = ids.iter().filter_map(|id| matches.try_get_raw(id).ok()?);
        raw.flatten().map(PathBuf::from).collect()
    };
    let (mut inputs, outputs) = (files(&INPUT_FILES), files(&["output", "report"]));
    // `calibrate` and `align` may replace the calibration that they update.
    if !matches!(name, "calibrate" | "align") {
        inputs.extend(files(&["with"]));
    }
    if let Command::Navigate(navigate) = parsed {
        let setup = &navigate.aids.setup;
        inputs.extend([&setup.anchors, &setup.geometry].into_iter().flatten().cloned());
    }
    if let Command::Calibrate(calibrate) = parsed {
        inputs.extend(Setup::read(&calibrate.setup).ok().and_then(|setup| setup.geometry));
    }
    outputs.iter().try_for_each(|output| is_writable(name, output))?;
    let real = |path: &PathBuf| path.canonicalize().ok();
    let outputs: Vec<PathBuf> = outputs.iter().filter_map(real).collect();
    match inputs.iter().find(|input| real(input).is_some_and(|input| outputs.contains(&input))) {
        None => Ok(()),
        Some(input) => {
            let message = "the output file is the input file and would overwrite it";
            Err(usage(message, "name another output file").at(input.display().to_string()))
        }
    }
}

/// Refuses an output that is a folder, lies in none, or has a name that says another format.
fn is_writable(command: &str, output: &Path) -> Result<()> {
    let refused = |message: String, remedy: &str| {
        Err(usage(message, remedy).at(output.display().to_string()))
    };
    if output.is_dir() {
        return refused("the output is a folder".to_owned(), "name a file in it");
    }
    let folder = output.parent().filter(|folder| !folder.as_os_str().is_empty());
    if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
        let message = format!("there is no folder {}", folder.display());
        return refused(message, "create it, or name another file");
    }
    let Some(extension) = output.extension().map(|text| text.to_string_lossy().to_lowercase())
    else {
        return Ok(());
    };
    if command == "record" && extension != "mcap" {
        return refused("a recording is an MCAP file".to_owned(), "name it FILE.mcap");
    }
    if OTHER_FORMATS.contains(&&*extension) {
        return refused(
            format!(".{extension} is not written"),
            "name it .csv, .mcap, .html or .json",
        );
    }
    Ok(())
}

/// An option or a key of the setup, as it is given.
fn written(name: &str) -> String {
    let is_key = NEED.iter().any(|(key, _)| *key == name) && name != "ranges";
    if is_key || ["geometry", "anchors", "full_scales_g"].contains(&name) {
        return format!("{name} in the setup");
    }
    format!("--{name}")
}

fn of_navigation(given: &[&str], has_boards: bool) -> Result<()> {
    for (one, others) in EXCLUDE.iter().filter(|(one, _)| given.contains(one)) {
        if let Some(other) = others.iter().find(|other| given.contains(other)) {
            let message = format!("{} does not go with {}", written(other), written(one));
            return Err(usage(message, "leave one of the two out"));
        }
    }
    for (one, others) in NEED.iter().filter(|(one, _)| given.contains(one)) {
        if !others.iter().any(|other| given.contains(other)) {
            let needed: Vec<String> = others.iter().map(|other| written(other)).collect();
            let message = format!("{} needs {}", written(one), needed.join(" or "));
            let remedy = match *one {
                "ranges" | "range_errors" | "survey_m" => "add --setup anchors=ANCHORS.csv",
                _ => "add it, or leave it out",
            };
            return Err(usage(message, remedy));
        }
    }
    let several = ["full_scales_g", "relative"];
    if has_boards && !several.iter().any(|option| given.contains(option)) {
        let remedy = "add --relative, or `--setup full_scales_g=[G,G]`";
        return Err(usage("several recordings are given for one unit", remedy));
    }
    Ok(())
}

/// Several sessions are files, each calibrated with the same method.
fn several(matches: &ArgMatches) -> Result<()> {
    let Some(more) = matches.get_many::<PathBuf>("more") else {
        return Ok(());
    };
    let one = "give one file, or calibrate with --method multi-position or six-position";
    let methods = [Method::MultiPosition, Method::SixPosition];
    let method = matches.get_one::<Method>("method");
    if !method.is_some_and(|method| methods.contains(method)) {
        return Err(usage("several sessions do not go with this method", one));
    }
    let input = matches.get_one::<String>("input").cloned();
    let names = more.map(|file| file.display().to_string());
    for name in input.into_iter().chain(names) {
        if let Ok(Input::Link(_)) = Input::parse(&name) {
            let remedy = "record each session with `wimu record LINK -o FILE.mcap` first";
            return Err(usage("several sessions are files, and this is a LINK", remedy).at(name));
        }
    }
    Ok(())
}

fn by_value(table: &Table, matches: &ArgMatches, given: &[&str]) -> Result<()> {
    let raw = matches.get_raw(table.decided_by);
    let Some(value) = raw.and_then(|mut raw| raw.next()?.to_str()) else {
        return Ok(());
    };
    let name = |value: &str| format!("--{} {value}", table.decided_by);
    for (option, marks) in table.rows {
        let marks = table.values.iter().zip(marks.split(' '));
        let goes_with: Vec<String> =
            marks.filter(|(_, mark)| *mark == "×").map(|(value, _)| name(value)).collect();
        if given.contains(option) && !goes_with.contains(&name(value)) {
            let remedy = format!("leave it out, or use {}", goes_with.join(", "));
            return Err(usage(format!("--{option} does not go with {}", name(value)), remedy));
        }
    }
    Ok(())
}

fn by_input(matches: &ArgMatches, given: &[&str]) -> Result<()> {
    let input = matches.get_raw("input").and_then(|mut raw| raw.next());
    let input = input.unwrap_or_default().to_string_lossy();
    let kind = match Input::parse(&input) {
        Ok(Input::File(_)) => TABLE,
        Ok(Input::Recording(_)) => "a recording of wimu",
        Ok(Input::Link(_)) => "a LINK",
        // The command reports it when it reads the input.
        Err(_) => return Ok(()),
    };
    let beside = |option: &&&str| given.contains(*option);
    if let (true, Some(option)) =
        (given.contains(&"anchors") && kind != "a LINK", BESIDE_A_BOARD.iter().find(beside))
    {
        let message = format!("--{option} goes with anchors only if INPUT is a LINK");
        return Err(usage(message, "leave one of the two out").at(input));
    }
    let topic = matches.get_one::<String>("topic").map(String::as_str);
    if let ("a recording of wimu", Some(topic)) =
        (kind, topic.filter(|topic| !LINKS.contains(topic)))
    {
        let message = format!("a recording of wimu has no topic {topic:?}");
        return Err(usage(message, "give the link: --topic cable or wireless").at(input));
    }
    for (option, needed) in INPUTS {
        if option == "topic" && kind == "a recording of wimu" {
            continue;
        }
        let fits = needed == kind || (needed == FILE && kind != "a LINK");
        if !fits && given.contains(&option) {
            let remedy = match option {
                "push" => {
                    "write the result with -o and push it with `wimu device params push LINK CAL.json`"
                }
                _ => "leave it out",
            };
            return Err(usage(
                format!("{} needs {needed}; this is {kind}", written(option)),
                remedy,
            )
            .at(input));
        }
    }
    Ok(())
}
