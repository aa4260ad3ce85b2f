//! How much flash and RAM an image takes, read from its ELF file.

use std::path::Path;

use object::elf::{SHF_ALLOC, SHF_WRITE};
use object::read::elf::ElfFile32;
use object::{Object as _, ObjectSection as _, ObjectSymbol as _, SectionFlags};

use crate::Result;

/// Parts of the names of functions that sign and check writes. Code that the compiler inlined elsewhere is not counted.
const AUTHENTICATION: [&str; 6] =
    ["wimu_link::auth::", "sha2::", "hmac::", "digest::", "block_buffer::", "crypto_common::"];

/// Bytes.
#[derive(Debug, Default)]
pub struct Size {
    pub flash: u32,
    /// Without the stack.
    pub ram: u32,
    /// Flash of [`AUTHENTICATION`].
    pub authentication: u32,
}

impl Size {
    /// Of a 32-bit little-endian ELF file.
    pub fn read(image: &Path) -> Result<Self> {
        let elf = std::fs::read(image).map_err(|error| format!("{}: {error}", image.display()))?;
        let elf = ElfFile32::<object::LittleEndian>::parse(&*elf)?;
        let mut size = Self::default();
        for section in elf.sections() {
            let SectionFlags::Elf { sh_flags, .. } = section.flags() else { continue };
            // An ESP32-C3's stack is a section.
            if sh_flags.0 & SHF_ALLOC.0 == 0 || section.name()? == ".stack" {
                continue;
            }
            // Initial values are in flash, and their variables in RAM.
            if section.file_range().is_some() {
                size.flash += section.size() as u32;
            }
            if sh_flags.0 & SHF_WRITE.0 != 0 {
                size.ram += section.size() as u32;
            }
        }
        for symbol in elf.symbols() {
            let name = format!("{:#}", rustc_demangle::demangle(symbol.name()?));
            if AUTHENTICATION.iter().any(|part| name.contains(part)) {
                size.authentication += symbol.size() as u32;
            }
        }
        Ok(size)
    }
}
