//! How much flash and RAM an image takes, in whole and by crate, read from its ELF file.

use std::collections::BTreeMap;

use crate::command_line::heading;
use crate::firmware;
use crate::setup::{self, Need, TARGETS, ThisMachine};
use crate::workspace::Workspace;

/// Crates below this many bytes of code are added up.
const WORTH_A_LINE: u32 = 1024;

/// Builds every board and prints the sizes of its images.
///
/// # Errors
/// Says which command failed, or which image cannot be read.
pub fn run(workspace: &Workspace) -> Result<(), String> {
    let source = setup::provide(Need::Targets, &mut ThisMachine)?;
    let mut found = Vec::new();
    for folder in &workspace.firmware {
        let output = firmware::built(source, folder, None)?;
        for program in &output.programs {
            for target in TARGETS {
                // A board is built for one of them only.
                let image = output.image(program, target);
                let Ok(bytes) = std::fs::read(&image) else {
                    continue;
                };
                let size = Size::of(&bytes)
                    .ok_or_else(|| format!("{}: no ELF file of 32 bits", image.display()))?;
                found.push((format!("{program} ({target})"), size));
            }
        }
    }
    for (name, size) in &found {
        heading(name);
        print!("{}", table(size));
    }
    Ok(())
}

/// Bytes.
#[derive(Debug, Default, PartialEq)]
struct Size {
    flash: u32,
    /// Without the stack.
    ram: u32,
    /// Of code, by the crate that it is from.
    crates: BTreeMap<String, u32>,
}

const SECTION_PROGBITS: u32 = 1;
const SECTION_SYMBOLS: u32 = 2;
const SECTION_NOBITS: u32 = 8;
const FLAG_WRITE: u32 = 1;
const FLAG_ALLOCATED: u32 = 2;
const SYMBOL_FUNCTION: u8 = 2;

/// The fields of an ELF section's header that matter here.
struct Section {
    kind: u32,
    flags: u32,
    offset: usize,
    size: u32,
    link: usize,
}

impl Size {
    /// `None` if `elf` is no little-endian ELF file of 32 bits.
    fn of(elf: &[u8]) -> Option<Self> {
        if elf.get(..6)? != b"\x7fELF\x01\x01" {
            return None;
        }
        let table = word(elf, 0x20)? as usize;
        let stride = usize::from(half(elf, 0x2e)?);
        let sections: Vec<Section> = (0..usize::from(half(elf, 0x30)?))
            .map(|index| {
                let at = table + index * stride;
                Some(Section {
                    kind: word(elf, at + 4)?,
                    flags: word(elf, at + 8)?,
                    offset: word(elf, at + 16)? as usize,
                    size: word(elf, at + 20)?,
                    link: word(elf, at + 24)? as usize,
                })
            })
            .collect::<Option<_>>()?;
        let mut size = Self::default();
        for section in &sections {
            let allocated = section.flags & FLAG_ALLOCATED != 0;
            // Initial values are in flash, and their variables in RAM.
            if allocated && section.kind != SECTION_NOBITS {
                size.flash += section.size;
            }
            let written = section.flags & FLAG_WRITE != 0;
            if allocated && written && [SECTION_PROGBITS, SECTION_NOBITS].contains(&section.kind) {
                size.ram += section.size;
            }
            if section.kind == SECTION_SYMBOLS {
                let names = sections.get(section.link)?.offset;
                size.add_code(elf, section, names)?;
            }
        }
        Some(size)
    }

    fn add_code(&mut self, elf: &[u8], symbols: &Section, names: usize) -> Option<()> {
        for at in (symbols.offset..symbols.offset + symbols.size as usize).step_by(16) {
            if elf.get(at + 12)? & 15 == SYMBOL_FUNCTION {
                let name = elf.get(names + word(elf, at)? as usize..)?;
                let name = name.split(|&byte| byte == 0).next()?;
                let of = crate_of(std::str::from_utf8(name).ok()?);
                *self.crates.entry(of.to_owned()).or_default() += word(elf, at + 8)?;
            }
        }
        Some(())
    }
}

fn half(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

/// The crate in a mangled name: its first part, or the first type in it.
fn crate_of(symbol: &str) -> &str {
    const OTHER: &str = "without a crate";
    let Some(path) = symbol.strip_prefix("_ZN") else {
        return OTHER;
    };
    let digits = path.len() - path.trim_start_matches(|c: char| c.is_ascii_digit()).len();
    let (length, rest) = path.split_at(digits);
    let first = length
        .parse()
        .ok()
        .and_then(|length: usize| rest.get(..length));
    let Some(first) = first else { return OTHER };
    // `<wimu_link::batch::Batch as …>` is `_$LT$wimu_link..batch..Batch$u20$as…`.
    let first = first.rsplit_once("$LT$").map_or(first, |(_, inner)| inner);
    let end = first.find(|c: char| !c.is_ascii_alphanumeric() && c != '_');
    match first.get(..end.unwrap_or(first.len())) {
        Some(name) if name.starts_with(|c: char| c.is_ascii_lowercase()) => name,
        _ => OTHER,
    }
}

fn table(size: &Size) -> String {
    let mut text = format!(
        "flash {:>7} bytes\nRAM   {:>7} bytes, and the stack\n",
        size.flash, size.ram
    );
    let mut crates: Vec<_> = size.crates.iter().collect();
    crates.sort_by_key(|&(_, bytes)| std::cmp::Reverse(bytes));
    let (large, small): (Vec<_>, Vec<_>) = crates
        .into_iter()
        .partition(|&(_, &bytes)| bytes >= WORTH_A_LINE);
    for (name, bytes) in large {
        text += &format!("  code {bytes:>7} {name}\n");
    }
    let small: u32 = small.into_iter().map(|(_, bytes)| bytes).sum();
    text + &format!("  code {small:>7} in all others\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crate_is_found_in_a_mangled_name() {
        for (symbol, of) in [
            (
                "_ZN9wimu_link5batch11encode_axis17h7acac7af30088277E",
                "wimu_link",
            ),
            (
                "_ZN60_$LT$wimu_link..batch..Batch$u20$as$u20$core..fmt..Debug$GT$3fmt17h0E",
                "wimu_link",
            ),
            ("__aeabi_memclr4", "without a crate"),
            ("_ZN", "without a crate"),
            ("_ZN99short", "without a crate"),
        ] {
            assert_eq!(crate_of(symbol), of, "{symbol}");
        }
    }

    #[test]
    fn what_is_no_elf_file_has_no_size() {
        assert_eq!(Size::of(b""), None);
        assert_eq!(Size::of(b"\x7fELF\x01\x01"), None);
        assert_eq!(Size::of(&[0; 64]), None);
    }

    #[test]
    fn small_crates_are_added_up() {
        let size = Size {
            flash: 5000,
            ram: 12,
            crates: [("big", 4000), ("a", 10), ("b", 20)]
                .map(|(n, b)| (n.to_owned(), b))
                .into(),
        };
        let text = table(&size);
        assert!(
            text.contains("4000 big") && text.contains("30 in all others"),
            "{text}"
        );
    }
}
