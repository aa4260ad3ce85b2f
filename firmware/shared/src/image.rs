//! The image in flash and its CRC, which `cargo xtask firmware` appends.

use core::ptr::addr_of;
use core::slice;

/// The first of the two words behind an image, "WIMU". The second is the CRC-32C of the image from the reset
/// vector on. The word before it may be at address 0, where Rust allows no data.
const MARK: u32 = u32::from_le_bytes(*b"WIMU");

unsafe extern "C" {
    /// Start of the image, and the initial values of variables at its end, from the linker.
    static __vector_table: u32;
    static __sidata: u32;
    static __sdata: u32;
    static __edata: u32;
}

/// The CRC of the image in flash if it differs from the one that was appended. An image without one is not checked.
pub fn damaged() -> Option<u32> {
    let start = addr_of!(__vector_table) as usize + 4;
    let data = addr_of!(__edata) as usize - addr_of!(__sdata) as usize;
    let end = (addr_of!(__sidata) as usize + data).next_multiple_of(4);
    // SAFETY: the image and the two words behind it are in the flash, which nothing writes now.
    let (image, [mark, crc]) = unsafe {
        let image = slice::from_raw_parts(start as *const u8, end - start);
        (image, (end as *const [u32; 2]).read_volatile())
    };
    let found = (mark == MARK).then(|| wimu_link::crc_32c(image))?;
    (found != crc).then_some(found)
}
