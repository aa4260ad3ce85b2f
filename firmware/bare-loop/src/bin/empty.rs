//! An image without code of its own: what the other one has beside the loop.

#![no_std]
#![no_main]

#[cortex_m_rt::entry]
fn main() -> ! {
    bare_loop_image::idle()
}
