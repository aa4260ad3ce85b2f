//! Chunks of records, compressed or not.

use std::borrow::Cow;
use std::io::Read;

use crate::mcap_file::records::fill;

/// Longest record or decompressed chunk, bytes. Recorders write chunks of at most some MB.
pub(super) const MAX_BYTES: u64 = 256 * 1024 * 1024;

/// The `size` bytes of a chunk from its stored bytes; of a chunk that is `cut` off those before the end.
pub(super) fn decompress<'a>(
    compression: &[u8],
    stored: &'a [u8],
    size: u64,
    cut: bool,
) -> Result<Cow<'a, [u8]>, String> {
    if size > MAX_BYTES {
        let (mb, most) = (size >> 20, MAX_BYTES >> 20);
        return Err(format!("its decompressed size of {mb} MB is above {most} MB"));
    }
    let reader: Result<Box<dyn Read + 'a>, _> = match compression {
        b"" | b"none" => {
            let length = stored.len().min(size as usize);
            return Ok(Cow::Borrowed(&stored[..length]));
        }
        b"lz4" => Ok(Box::new(lz4_flex::frame::FrameDecoder::new(stored))),
        b"bz2" => Ok(Box::new(bzip2::read::BzDecoder::new(stored))),
        b"zstd" => ruzstd::decoding::StreamingDecoder::new(stored)
            .map(|decoder| Box::new(decoder) as Box<dyn Read>)
            .map_err(|error| format!("its compression is damaged ({error})")),
        other => Err(format!(
            "its compression `{}` is not known",
            String::from_utf8_lossy(other).escape_debug()
        )),
    };
    let mut bytes = Vec::new();
    match reader.map(|reader| fill(reader.take(size + 1), size + 1, &mut bytes)) {
        _ if cut => Ok(Cow::Owned(bytes)),
        Err(reason) => Err(reason),
        Ok(Err(error)) => Err(format!("its compression is damaged ({error})")),
        Ok(Ok(_)) if bytes.len() as u64 != size => {
            Err(format!("it does not decompress to its {size} bytes"))
        }
        Ok(Ok(_)) => Ok(Cow::Owned(bytes)),
    }
}
