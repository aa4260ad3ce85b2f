//! Lines of source: those of Rust outside and in tests by place, and those of other languages; words of the documents.
//!
//! Tests are folders `tests`, files `tests.rs`, and items under `cfg(test)`, with the file or folder of a module that is
//! such an item. Examples and benches count as code; blank lines and comments count.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use proc_macro2::{Delimiter, TokenStream, TokenTree};
use xshell::{Shell, cmd};

use crate::Result;

/// The rows of the table: a name, and the folders that are counted in it. A file belongs to the first that fits.
const PLACES: [(&str, &[&str]); 16] = [
    ("crates/wimu-model", &["crates/wimu-model"]),
    ("crates/wimu-integrator", &["crates/wimu-integrator"]),
    ("crates/wimu-link", &["crates/wimu-link"]),
    ("crates/wimu-node", &["crates/wimu-node"]),
    ("crates/wimu-calib", &["crates/wimu-calib"]),
    ("crates/wimu-nav", &["crates/wimu-nav"]),
    ("crates/wimu-embassy, drivers", &["crates"]),
    ("firmware, examples", &["firmware", "examples"]),
    (
        "wimu-host: calibration, guide",
        &[
            "host-tools/wimu-host/src/calibration",
            "host-tools/wimu-host/src/calibration.rs",
            "host-tools/wimu-host/src/guided",
            "host-tools/wimu-host/src/guided.rs",
        ],
    ),
    (
        "wimu-host: navigation",
        &[
            "host-tools/wimu-host/src/array",
            "host-tools/wimu-host/src/array.rs",
            "host-tools/wimu-host/src/hand_eye",
            "host-tools/wimu-host/src/inertial",
            "host-tools/wimu-host/src/localization",
            "host-tools/wimu-host/src/multi_range",
            "host-tools/wimu-host/src/multi_range.rs",
            "host-tools/wimu-host/src/navigation.rs",
            "host-tools/wimu-host/src/relative",
        ],
    ),
    ("wimu-host: fleet", &["host-tools/wimu-host/src/fleet", "host-tools/wimu-host/src/fleet.rs"]),
    ("wimu-host: all else", &["host-tools/wimu-host"]),
    ("host-tools/wimu", &["host-tools/wimu"]),
    ("host-tools/wimu-sim", &["host-tools/wimu-sim"]),
    ("wimu-python, wimu-testkit, xtask, scores", &["host-tools"]),
    ("tests", &[""]),
];
/// Languages beside Rust, by the ends of their files' names.
const OTHERS: [(&str, &[&str]); 3] =
    [("JavaScript", &["js", "mjs"]), ("CSS", &["css"]), ("Python", &["py"])];
/// Parts of the documents: a name, and the files and folders that are counted in it. Words are
/// separated by white space, as `wc -w` counts them: tables, code and output included. Not counted: CHANGELOG.md.
const DOCUMENTS: [(&str, &[&str]); 6] = [
    ("README, CONTRIBUTING", &["README.md", "CONTRIBUTING.md"]),
    ("docs/start", &["docs/start", "docs/README.md", "docs/samples"]),
    ("docs/how-to", &["docs/how-to"]),
    ("docs/explanation", &["docs/explanation"]),
    ("docs/reference", &["docs/reference"]),
    ("READMEs of crates, firmware, tests", &["crates", "firmware", "host-tools", "tests"]),
];

/// Prints the lines of all files that git tracks or would track.
pub fn run(sh: &Shell) -> Result {
    let listing = cmd!(sh, "git ls-files --cached --others --exclude-standard").quiet().read()?;
    let files: Vec<&Path> = listing.lines().map(Path::new).filter(|file| file.exists()).collect();
    let ends_with =
        |file: &Path, ends: &[&str]| ends.iter().any(|end| file.extension() == Some(end.as_ref()));
    let mut rust = Vec::new();
    let mut test_modules = BTreeSet::new();
    for file in files.iter().filter(|file| ends_with(file, &["rs"])) {
        let counted =
            counted(&sh.read_file(file)?).map_err(|why| format!("{}: {why}", file.display()));
        let (code, tests, modules) = counted?;
        test_modules.extend(modules.iter().map(|module| folder_of_modules(file).join(module)));
        rust.push((file, code, tests));
    }
    let mut rows = Vec::from(PLACES.map(|(name, _)| (name, 0, 0)));
    for (file, code, tests) in rust {
        let in_test_module = |part: &Path| test_modules.contains(&part.with_extension(""));
        let place =
            PLACES.iter().position(|(_, folders)| folders.iter().any(|f| file.starts_with(f)));
        let (_, all_code, all_tests) = &mut rows[place.ok_or("a file without a place")?];
        if is_test(file) || file.ancestors().any(in_test_module) {
            *all_tests += code + tests;
        } else {
            *all_code += code;
            *all_tests += tests;
        }
    }
    rows.push(rows.iter().fold(("sum", 0, 0), |sum, row| ("sum", sum.1 + row.1, sum.2 + row.2)));
    for (name, ends) in OTHERS {
        let mut row = (name, 0, 0);
        for file in files.iter().filter(|file| ends_with(file, ends)) {
            let lines = sh.read_file(file)?.lines().count();
            *(if is_test(file) { &mut row.2 } else { &mut row.1 }) += lines;
        }
        rows.push(row);
    }
    println!("{:<42}{:>14}{:>10}", "lines", "outside tests", "in tests");
    for (name, code, tests) in rows {
        println!("{name:<42}{code:>14}{tests:>10}");
    }
    println!("\n{:<42}{:>14}", "documents", "words");
    for (name, starts) in DOCUMENTS {
        let mut words = 0;
        for file in files.iter().filter(|file| ends_with(file, &["md"])) {
            if starts.iter().any(|start| file.starts_with(start)) {
                words += sh.read_file(file)?.split_whitespace().count();
            }
        }
        println!("{name:<42}{words:>14}");
    }
    Ok(())
}

fn is_test(file: &Path) -> bool {
    file.ends_with("tests.rs") || file.components().any(|part| part.as_os_str() == "tests")
}

/// Where the modules that a file declares are.
fn folder_of_modules(file: &Path) -> PathBuf {
    match file.file_name().and_then(|name| name.to_str()) {
        Some("lib.rs" | "main.rs" | "mod.rs") => file.parent().unwrap_or(file).to_owned(),
        _ => file.with_extension(""),
    }
}

/// The lines of a source outside and in tests, and the names of the modules under `cfg(test)` whose code is elsewhere.
fn counted(
    source: &str,
) -> std::result::Result<(usize, usize, Vec<String>), proc_macro2::LexError> {
    let mut found = Tests::default();
    found.collect(source.parse()?);
    Ok((source.lines().count() - found.lines.len(), found.lines.len(), found.modules))
}

/// What is under `cfg(test)`.
#[derive(Default)]
struct Tests {
    lines: BTreeSet<usize>,
    modules: Vec<String>,
}

impl Tests {
    fn collect(&mut self, tokens: TokenStream) {
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        let mut at = 0;
        while at < tokens.len() {
            let start = at;
            let mut is_test = false;
            while let [TokenTree::Punct(hash), TokenTree::Group(attribute), ..] = &tokens[at..]
                && hash.as_char() == '#'
                && attribute.delimiter() == Delimiter::Bracket
            {
                is_test |= is_cfg_test(attribute.stream());
                at += 2;
            }
            if !is_test {
                if let Some(TokenTree::Group(group)) = tokens.get(at) {
                    self.collect(group.stream());
                }
                at += 1;
                continue;
            }
            let item = &tokens[at..];
            let length = item.iter().position(ends_an_item).map_or(item.len(), |last| last + 1);
            if let [TokenTree::Ident(word), TokenTree::Ident(name), TokenTree::Punct(_)] =
                &item[..length]
                && word == "mod"
            {
                self.modules.push(name.to_string());
            }
            at += length;
            self.lines.extend(tokens[start].span().start().line..=tokens[at - 1].span().end().line);
        }
    }
}

fn ends_an_item(token: &TokenTree) -> bool {
    match token {
        TokenTree::Punct(punct) => punct.as_char() == ';',
        TokenTree::Group(group) => group.delimiter() == Delimiter::Brace,
        _ => false,
    }
}

/// Whether an attribute is `cfg(test)` or `cfg(all(test, …))`.
fn is_cfg_test(attribute: TokenStream) -> bool {
    let text = attribute.to_string().replace(char::is_whitespace, "");
    text == "cfg(test)" || text.starts_with("cfg(all(test,")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn items_under_cfg_test_are_tests_and_everything_else_is_code() {
        let source = "\
//! \"}\"
#[cfg(test)]
mod elsewhere;
use a; // {
/// About.
#[cfg(all(test, unix))]
fn one<'a>() -> [u8; 3] {
    '{'
}

#[cfg(not(test))]
mod product;
impl A {
    #[cfg(test)]
    const B: [u8; 2] = [1, 2];
    #[test]
    fn c() {}
}
";
        let tests = 2 + 5 + 2;
        let code = source.lines().count() - tests;
        assert_eq!(counted(source).expect("Rust"), (code, tests, vec!["elsewhere".into()]));
    }
}
