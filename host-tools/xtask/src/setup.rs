//! Finds or installs what the tests need beyond cargo: the formatter, the linter, `core` for two
//! microcontrollers, emulators of two, Python, a C compiler, a browser and an MQTT broker.

use std::path::{Path, PathBuf};

use crate::command_line::{CommandLine, is_ci};
use crate::python;

/// Cortex-M4F and Cortex-M0+.
pub const TARGETS: [&str; 2] = ["thumbv7em-none-eabihf", "thumbv6m-none-eabi"];

/// The oldest Rust that users may have.
pub const OLDEST: &str = env!("CARGO_PKG_RUST_VERSION");

/// Something the tests need.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Need {
    Components,
    Targets,
    Qemu,
    /// The oldest compiler that users may have.
    Oldest,
    /// Of reports: Chromium.
    Browser,
    /// Of boards with a radio: their build scripts read C headers.
    Libclang,
    /// Of links over Bluetooth Low Energy, on Linux.
    Dbus,
    /// Of fleets: Mosquitto, and a clock that jumps.
    Broker,
    /// Of the Python module and of reading sqlite: Python with virtual environments, and a C compiler.
    Optional,
}

/// Where it can come from, the better first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Source {
    /// The active toolchain, to which rustup adds.
    Toolchain,
    /// Debian's packages beside it, to which apt-get adds; `core` is then built from source.
    Debian,
}

/// What the search asks of a machine, so that it can be tested without one.
pub trait Machine {
    fn has(&self, need: Need, source: Source) -> bool;
    /// Whether the installer of `source` is there.
    fn can_add_to(&self, source: Source) -> bool;
    fn may_install(&self) -> bool;
    fn run(&mut self, command: &CommandLine) -> Result<(), String>;
}

/// Finds every need on this machine, or installs it.
pub fn run() -> Result<(), String> {
    for need in [Need::Components, Need::Targets, Need::Qemu] {
        provide(need, &mut ThisMachine)?;
    }
    python::environment("numpy")?;
    // Without one of these a step is left out, no more.
    for need in [Need::Oldest, Need::Browser, Need::Broker, Need::Libclang, Need::Dbus] {
        if let Err(why) = provide(need, &mut ThisMachine) {
            println!("{why}");
        }
    }
    if let Err(why) = emulator() {
        println!("{why}");
    }
    Ok(())
}

/// Where the emulator of the Pico is.
pub const PICO_EMULATOR: &str = "tests/pico";

/// Finds the emulator of the Pico, or has npm install it.
///
/// # Errors
/// Says what to install or run.
pub fn emulator() -> Result<(), String> {
    let there = |line: &str| CommandLine::new(line).output().is_some();
    let folder = Path::new(PICO_EMULATOR);
    if !there("node --version") {
        return Err(
            "the Pico's emulator: missing; it runs on Node.js 18 or newer (https://nodejs.org)"
                .into(),
        );
    }
    if !folder.join("node_modules/rp2040js").is_dir() {
        let install = CommandLine::new("npm ci --no-audit --no-fund").inside(folder);
        install.run().map_err(|problem| {
            format!("the Pico's emulator: missing, and could not be installed: {problem}; with a network run\n    {install}")
        })?;
    }
    println!("the Pico's emulator: installed");
    Ok(())
}

/// Finds `need`, or installs it: where it now is.
///
/// # Errors
/// Says which command to run when nothing was found and nothing could or may be installed.
pub fn provide(need: Need, machine: &mut impl Machine) -> Result<Source, String> {
    let mut advice = Vec::new();
    for source in [Source::Toolchain, Source::Debian] {
        let commands = install(need, source);
        if !commands.is_empty() && !machine.has(need, source) && machine.can_add_to(source) {
            let lines: Vec<String> = commands.iter().map(ToString::to_string).collect();
            advice.push(lines.join(" && "));
            if machine.may_install() {
                // One that fails, for want of a network or a package, is followed by the next.
                if let Err(problem) = commands.iter().try_for_each(|c| machine.run(c)) {
                    eprintln!("{problem}");
                }
            }
        }
        if machine.has(need, source) {
            println!("{}: {}", need.name(), need.found(source));
            return Ok(source);
        }
    }
    let name = need.name();
    Err(match (advice.is_empty(), machine.may_install()) {
        (true, _) => format!("{name}: missing; {}", need.otherwise()),
        (false, true) => {
            format!("{name}: missing, and could not be installed by {}", advice.join("; nor by "))
        }
        (false, false) => format!(
            "{name}: missing; run\n    {}\n(with CI=true, or as root, `cargo xtask setup` runs it)",
            advice.join("\nor\n    ")
        ),
    })
}

/// `cargo VERB`, build or check, for [`TARGETS`] from `source`.
pub fn embedded_cargo(source: Source, verb: &str) -> CommandLine {
    let cargo = match source {
        Source::Toolchain => return CommandLine::new("cargo").word(verb).word("--locked"),
        // Debian ships no core for these targets, but its sources; nor a rust-lld, but an lld.
        Source::Debian => CommandLine::new("/usr/bin/cargo")
            .word(verb)
            .words("--locked")
            .words("-Zbuild-std=core,alloc -Zbuild-std-features=compiler-builtins-mem")
            .with("RUSTC_BOOTSTRAP", "1")
            .with("RUSTC", "/usr/bin/rustc"),
    };
    TARGETS.iter().fold(cargo, |cargo, target| {
        let name = target.replace('-', "_").to_uppercase();
        cargo.with(&format!("CARGO_TARGET_{name}_LINKER"), "ld.lld")
    })
}

/// The release of the compiler that [`embedded_cargo`] runs, like `1.95.0`.
///
/// # Errors
/// When it does not say.
pub fn embedded_release(source: Source) -> Result<String, String> {
    let line = CommandLine::new(match source {
        Source::Toolchain => "rustc --version",
        Source::Debian => "/usr/bin/rustc --version",
    });
    let said = line.output().unwrap_or_default();
    let release = said.split_whitespace().nth(1).map(str::to_owned);
    release.ok_or_else(|| format!("`{line}` failed: run it to see why"))
}

/// `cargo SUBCOMMAND` that leaves the lock file alone on a CI machine.
pub fn cargo(subcommand: &str) -> CommandLine {
    // Before the rest: what follows a `--` is not cargo's.
    let (verb, rest) = subcommand.split_once(' ').unwrap_or((subcommand, ""));
    locked(CommandLine::new("cargo").word(verb)).words(rest)
}

fn locked(cargo: CommandLine) -> CommandLine {
    if is_ci() { cargo.word("--locked") } else { cargo }
}

/// The folder of libclang: that in `LIBCLANG_PATH`, or the newest that is installed. Debian's finds its own headers only
/// in its folder below `/usr/lib`.
pub fn libclang() -> Option<PathBuf> {
    if let Some(named) = std::env::var_os("LIBCLANG_PATH") {
        return Some(named.into());
    }
    let debian = std::fs::read_dir("/usr/lib").into_iter().flatten();
    let debian = debian.flatten().filter_map(|entry| {
        let name = entry.file_name();
        let version: u32 = name.to_str()?.strip_prefix("llvm-")?.parse().ok()?;
        Some((version, entry.path().join("lib")))
    });
    let others = [
        "/usr/lib64",
        "/usr/lib",
        "/opt/homebrew/opt/llvm/lib",
        "/Library/Developer/CommandLineTools/usr/lib",
    ];
    let others = others.into_iter().map(|folder| (0, folder.into()));
    let found = debian.chain(others).filter(|(_, folder)| holds_libclang(folder));
    found.max_by_key(|(version, _)| *version).map(|(_, folder)| folder)
}

fn holds_libclang(folder: &Path) -> bool {
    let is_library = |name: &str| {
        let rest = name.strip_prefix("libclang").unwrap_or_default();
        rest.starts_with(['.', '-']) && !rest.starts_with("-cpp") && !rest.ends_with(".a")
    };
    std::fs::read_dir(folder).is_ok_and(|mut entries| {
        entries.any(|e| e.is_ok_and(|e| e.file_name().to_str().is_some_and(is_library)))
    })
}

/// None where `source` has nothing of the kind.
fn install(need: Need, source: Source) -> Vec<CommandLine> {
    match source {
        Source::Toolchain => match need {
            Need::Components => vec![CommandLine::new("rustup component add rustfmt clippy")],
            Need::Targets => {
                vec![CommandLine::new("rustup target add").words(&TARGETS.join(" "))]
            }
            Need::Qemu
            | Need::Browser
            | Need::Broker
            | Need::Libclang
            | Need::Dbus
            | Need::Optional => Vec::new(),
            Need::Oldest => {
                vec![CommandLine::new("rustup toolchain install --profile minimal").word(OLDEST)]
            }
        },
        Source::Debian => {
            let packages = match need {
                Need::Components => "rustfmt-web rust-web-clippy",
                Need::Targets => "rustc-web cargo-web rust-web-src lld",
                Need::Qemu => "qemu-system-arm",
                Need::Browser => "chromium",
                Need::Libclang => "libclang-dev",
                Need::Dbus => "libdbus-1-dev pkg-config",
                Need::Broker => "mosquitto faketime",
                Need::Optional => "python3 python3-venv gcc libc6-dev",
                Need::Oldest => return Vec::new(),
            };
            let apt = if is_root() { "apt-get" } else { "sudo apt-get" };
            vec![
                CommandLine::new(apt).words("update"),
                CommandLine::new(apt)
                    .words("install --yes --no-install-recommends")
                    .words(packages),
            ]
        }
    }
}

impl Need {
    fn name(self) -> String {
        match self {
            Self::Components => "rustfmt and clippy".into(),
            Self::Targets => TARGETS.join(" and "),
            Self::Qemu => "qemu-system-arm".into(),
            Self::Browser => "Chromium".into(),
            Self::Broker => "Mosquitto with faketime".into(),
            Self::Oldest => format!("Rust {OLDEST}"),
            Self::Libclang => "libclang".into(),
            Self::Dbus => "libdbus".into(),
            Self::Optional => "Python 3 with venv and a C compiler".into(),
        }
    }

    /// Where it was found.
    fn found(self, source: Source) -> &'static str {
        match (self, source) {
            (Self::Components | Self::Targets, Source::Toolchain) => "in the active toolchain",
            (Self::Components | Self::Targets, Source::Debian) => "from Debian's packages",
            _ => "installed",
        }
    }

    /// What to do where there is no installer.
    fn otherwise(self) -> &'static str {
        match self {
            Self::Components | Self::Targets | Self::Oldest => {
                "install Rust with rustup (https://rustup.rs)"
            }
            Self::Qemu => "install QEMU (https://www.qemu.org/download)",
            Self::Browser => "install Chromium (https://www.chromium.org)",
            Self::Libclang => "install LLVM (https://releases.llvm.org)",
            Self::Dbus => "install the development files of libdbus",
            Self::Broker => "install Mosquitto (https://mosquitto.org/download)",
            Self::Optional => "install Python (https://www.python.org/downloads) and a C compiler",
        }
    }
}

/// The machine we run on.
pub struct ThisMachine;

impl Machine for ThisMachine {
    fn has(&self, need: Need, source: Source) -> bool {
        let succeeds = |line: &str| CommandLine::new(line).output().is_some();
        match (need, source) {
            // Debian's are found by the same cargo, which is then Debian's too.
            (Need::Components, _) => {
                succeeds("cargo fmt --version") && succeeds("cargo clippy --version")
            }
            (Need::Oldest, Source::Toolchain) => {
                succeeds(&format!("rustup run {OLDEST} cargo --version"))
            }
            (Need::Oldest, Source::Debian) => false,
            (Need::Libclang, Source::Debian) => libclang().is_some(),
            (Need::Dbus, Source::Debian) => {
                !cfg!(target_os = "linux") || succeeds("pkg-config --exists dbus-1")
            }
            (Need::Browser, Source::Debian) => succeeds("chromium --version"),
            // Its help ends with an error.
            (Need::Broker, Source::Debian) => {
                Path::new("/usr/sbin/mosquitto").exists() && Path::new("/usr/bin/faketime").exists()
            }
            (Need::Optional, Source::Debian) => {
                let python = CommandLine::new("python3 -c").word("import venv, ensurepip");
                python.output().is_some() && succeeds("cc --version")
            }
            (Need::Qemu, Source::Debian) => succeeds("qemu-system-arm --version"),
            (Need::Targets, Source::Debian) => {
                succeeds("/usr/bin/cargo --version")
                    && succeeds("ld.lld --version")
                    && CommandLine::new("/usr/bin/rustc --print sysroot").output().is_some_and(
                        |root| {
                            let source =
                                Path::new(root.trim()).join("lib/rustlib/src/rust/library");
                            source.join("core/Cargo.toml").exists()
                        },
                    )
            }
            (Need::Targets, Source::Toolchain) => TARGETS.iter().all(|target| {
                CommandLine::new("rustc --print target-libdir --target")
                    .word(target)
                    .output()
                    .is_some_and(|folder| holds_core(Path::new(folder.trim())))
            }),
            (_, Source::Toolchain) => false,
        }
    }

    fn can_add_to(&self, source: Source) -> bool {
        let installer = match source {
            Source::Toolchain => "rustup --version",
            Source::Debian => "apt-get --version",
        };
        CommandLine::new(installer).output().is_some()
    }

    fn may_install(&self) -> bool {
        is_ci() || is_root()
    }

    fn run(&mut self, command: &CommandLine) -> Result<(), String> {
        command.run()
    }
}

fn is_root() -> bool {
    CommandLine::new("id -u").output().is_some_and(|user| user.trim() == "0")
}

fn holds_core(folder: &Path) -> bool {
    let is_core = |name: &str| name.starts_with("libcore-") && name.ends_with(".rlib");
    std::fs::read_dir(folder).is_ok_and(|mut entries| {
        entries.any(|e| e.is_ok_and(|e| e.file_name().to_str().is_some_and(is_core)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A machine on which each installer that works adds everything.
    #[derive(Default)]
    struct Imagined {
        has: Vec<Source>,
        installers: Vec<Source>,
        broken: Vec<Source>,
        may_install: bool,
        ran: Vec<String>,
    }

    impl Machine for Imagined {
        fn has(&self, _: Need, source: Source) -> bool {
            self.has.contains(&source)
        }

        fn can_add_to(&self, source: Source) -> bool {
            self.installers.contains(&source)
        }

        fn may_install(&self) -> bool {
            self.may_install
        }

        fn run(&mut self, command: &CommandLine) -> Result<(), String> {
            let line = command.to_string();
            let source =
                if line.starts_with("rustup") { Source::Toolchain } else { Source::Debian };
            self.ran.push(line);
            if self.broken.contains(&source) {
                return Err("no network".into());
            }
            self.has.push(source);
            Ok(())
        }
    }

    #[test]
    fn a_folder_with_libclang_is_told_from_one_with_other_libraries_of_llvm() {
        let folder = std::env::temp_dir().join(format!("wimu-libclang-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        for (file, found) in [
            ("libclang-cpp.so.14", false),
            ("libclang.a", false),
            ("libLLVM-14.so", false),
            ("libclang-14.so.1", true),
        ] {
            std::fs::write(folder.join(file), "").unwrap();
            assert_eq!(holds_libclang(&folder), found, "{file}");
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }

    const BOTH: [Source; 2] = [Source::Toolchain, Source::Debian];

    #[test]
    fn what_the_toolchain_has_is_taken_and_nothing_is_installed() {
        let mut machine = Imagined {
            has: BOTH.into(),
            installers: BOTH.into(),
            may_install: true,
            ..Imagined::default()
        };
        assert_eq!(provide(Need::Targets, &mut machine), Ok(Source::Toolchain));
        assert!(machine.ran.is_empty());
    }

    #[test]
    fn rustup_is_asked_before_debian() {
        let mut machine =
            Imagined { installers: BOTH.into(), may_install: true, ..Imagined::default() };
        assert_eq!(provide(Need::Targets, &mut machine), Ok(Source::Toolchain));
        assert_eq!(machine.ran, ["rustup target add thumbv7em-none-eabihf thumbv6m-none-eabi"]);
    }

    #[test]
    fn debian_helps_where_rustup_has_no_network() {
        let mut machine = Imagined {
            installers: BOTH.into(),
            broken: vec![Source::Toolchain],
            may_install: true,
            ..Imagined::default()
        };
        assert_eq!(provide(Need::Targets, &mut machine), Ok(Source::Debian));
        assert!(machine.ran[0].starts_with("rustup"));
        assert!(machine.ran[2].contains("rust-web-src"), "{:?}", machine.ran);
    }

    #[test]
    fn debian_helps_where_there_is_no_rustup() {
        let mut machine =
            Imagined { installers: vec![Source::Debian], may_install: true, ..Imagined::default() };
        assert_eq!(provide(Need::Targets, &mut machine), Ok(Source::Debian));
    }

    #[test]
    fn without_permission_nothing_is_installed_and_the_command_is_given() {
        let mut machine = Imagined { installers: BOTH.into(), ..Imagined::default() };
        let problem = provide(Need::Components, &mut machine).expect_err("nothing is there");
        assert!(problem.contains("\n    rustup component add rustfmt clippy\n"), "{problem}");
        assert!(machine.ran.is_empty());
    }

    #[test]
    fn without_permission_debians_packages_are_used_if_they_are_there() {
        let mut machine =
            Imagined { has: vec![Source::Debian], installers: BOTH.into(), ..Imagined::default() };
        assert_eq!(provide(Need::Targets, &mut machine), Ok(Source::Debian));
        assert!(machine.ran.is_empty());
    }

    #[test]
    fn where_everything_fails_the_error_names_each_attempt() {
        let mut machine = Imagined {
            installers: BOTH.into(),
            broken: BOTH.into(),
            may_install: true,
            ..Imagined::default()
        };
        let problem = provide(Need::Targets, &mut machine).expect_err("nothing worked");
        assert!(problem.contains("rustup target add") && problem.contains("apt-get install"));

        let problem = provide(Need::Targets, &mut Imagined::default()).expect_err("no installer");
        assert!(problem.contains("https://rustup.rs"), "{problem}");
    }

    #[test]
    fn rustup_is_not_asked_for_an_emulator() {
        let mut machine =
            Imagined { installers: BOTH.into(), may_install: true, ..Imagined::default() };
        assert_eq!(provide(Need::Qemu, &mut machine), Ok(Source::Debian));
        let line = machine.ran.last().expect("an installer ran");
        assert!(line.ends_with("qemu-system-arm"), "{line}");
        let problem = provide(Need::Qemu, &mut Imagined::default()).expect_err("no installer");
        assert!(problem.contains("https://www.qemu.org"), "{problem}");
    }

    #[test]
    fn only_rustup_has_an_older_compiler() {
        let mut machine =
            Imagined { installers: BOTH.into(), may_install: true, ..Imagined::default() };
        assert_eq!(provide(Need::Oldest, &mut machine), Ok(Source::Toolchain));
        assert!(machine.ran[0].ends_with(OLDEST), "{:?}", machine.ran);

        let mut machine =
            Imagined { installers: vec![Source::Debian], may_install: true, ..Imagined::default() };
        let problem = provide(Need::Oldest, &mut machine).expect_err("no rustup");
        assert!(problem.contains("https://rustup.rs"), "{problem}");
        assert!(machine.ran.is_empty());
    }

    #[test]
    fn debians_cargo_builds_core_and_links_with_lld() {
        let line = embedded_cargo(Source::Debian, "build").to_string();
        for part in [
            "RUSTC=/usr/bin/rustc",
            "CARGO_TARGET_THUMBV6M_NONE_EABI_LINKER=ld.lld",
            "/usr/bin/cargo build --locked -Zbuild-std=core,alloc",
        ] {
            assert!(line.contains(part), "{line}");
        }
    }
}
