//! Images as boards take them without a probe: Intel HEX for drag and drop onto a micro:bit, UF2 for a Pico or a XIAO.

use std::path::{Path, PathBuf};

use ihex::Record;
use object::LittleEndian;
use object::elf::PT_LOAD;
use object::read::elf::{ElfFile32, ProgramHeader};
use object::{Object as _, ObjectSymbol as _};

use crate::Result;

/// Where the files go.
const FOLDER: &str = "target/firmware";
/// Bytes of a line of a HEX file.
const HEX_LINE: usize = 16;
/// Bytes of a block of a UF2 file that carry data.
const UF2_PAGE: u32 = 256;
/// The last word of a block's head is a family of boards.
const UF2_HAS_FAMILY: u32 = 0x2000;

/// How a board takes its image.
#[derive(Clone, Copy)]
pub enum Format {
    Hex,
    /// Of this family of boards.
    Uf2(u32),
}

/// Writes the image in the ELF file `elf` as the board in `folder` takes it; says where.
pub fn write(folder: &Path, elf: &Path, format: Format) -> Result<PathBuf> {
    let bytes = std::fs::read(elf).map_err(|error| format!("{}: {error}", elf.display()))?;
    let (start, image) = sealed(&bytes)?;
    let (content, extension) = match format {
        Format::Hex => (hex(start, &image)?.into_bytes(), "hex"),
        Format::Uf2(family) => (uf2(family, start, &image), "uf2"),
    };
    let name = folder.file_name().unwrap_or_default();
    let path = Path::new(FOLDER).join(name).with_extension(extension);
    std::fs::create_dir_all(FOLDER)?;
    std::fs::write(&path, content).map_err(|error| format!("{}: {error}", path.display()))?;
    Ok(path)
}

/// The loaded segments of an ELF file from the lowest address on, and behind them the two words that
/// `firmware/shared/src/image.rs` checks: "WIMU", and the CRC-32C from the reset vector on. Gaps are erased flash.
fn sealed(elf: &[u8]) -> Result<(u32, Vec<u8>)> {
    let file = ElfFile32::<LittleEndian>::parse(elf)?;
    let mut segments = Vec::new();
    for header in file.elf_program_headers() {
        if header.p_type(LittleEndian) == PT_LOAD && header.p_filesz(LittleEndian) > 0 {
            let data = header.data(LittleEndian, elf).map_err(|()| "a segment is cut off")?;
            segments.push((header.p_paddr(LittleEndian), data));
        }
    }
    segments.sort_by_key(|(address, _)| *address);
    let start = segments.first().ok_or("it is empty")?.0;
    let mut image = Vec::new();
    for (address, data) in segments {
        image.resize((address - start) as usize, 0xFF);
        image.extend_from_slice(data);
    }
    image.resize(image.len().next_multiple_of(4), 0xFF);
    let table = file.symbols().find(|symbol| symbol.name() == Ok("__vector_table"));
    let table = table.ok_or("it has no vector table")?.address() as u32;
    let checked = table.checked_sub(start).and_then(|offset| image.get(offset as usize + 4..));
    let checked = checked.ok_or("its vector table is elsewhere")?;
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISCSI).checksum(checked);
    image.extend_from_slice(b"WIMU");
    image.extend_from_slice(&crc.to_le_bytes());
    Ok((start, image))
}

/// `start` is a multiple of the length of a line.
fn hex(start: u32, image: &[u8]) -> Result<String> {
    let mut records = Vec::new();
    for (address, line) in (start..).step_by(HEX_LINE).zip(image.chunks(HEX_LINE)) {
        if records.is_empty() || address % 0x1_0000 == 0 {
            records.push(Record::ExtendedLinearAddress((address >> 16) as u16));
        }
        records.push(Record::Data { offset: address as u16, value: line.to_vec() });
    }
    records.push(Record::EndOfFile);
    Ok(ihex::create_object_file_representation(&records)?)
}

/// `start` is that of a page.
fn uf2(family: u32, start: u32, image: &[u8]) -> Vec<u8> {
    let pages = image.chunks(UF2_PAGE as usize);
    let count = pages.len() as u32;
    let mut blocks = Vec::new();
    for (index, page) in (0..).zip(pages) {
        let address = start + index * UF2_PAGE;
        let head = [0x0a32_4655, 0x9e5d_5157, UF2_HAS_FAMILY, address, UF2_PAGE, index, count];
        let head = head.into_iter().chain([family]);
        let block = blocks.len();
        blocks.extend(head.flat_map(u32::to_le_bytes));
        blocks.extend_from_slice(page);
        blocks.resize(block + 508, 0);
        blocks.extend(0x0ab1_6f30_u32.to_le_bytes());
    }
    blocks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hex_file_is_as_the_format_says() {
        let mut image = [0; 18];
        image[16..].copy_from_slice(&[0x21, 0x46]);
        let zeros = "00".repeat(16);
        let text = format!(
            ":020000040001F9\n:10FFF000{zeros}01\n:020000040002F8\n:02000000214697\n:00000001FF\n"
        );
        assert_eq!(hex(0x1_fff0, &image).unwrap(), text);
    }
}
