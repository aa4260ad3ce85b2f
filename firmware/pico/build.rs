//! Linker arguments, and where flash and RAM are.

#[path = "../shared/link.rs"]
mod link;

fn main() {
    // `--icf=all`: functions with the same code exist once.
    let mut arguments = vec!["--nmagic", "--icf=all", "-Tlink.x"];
    if std::env::var_os("CARGO_FEATURE_DEFMT").is_some() {
        arguments.push("-Tdefmt.x");
    }
    if std::env::var_os("CARGO_FEATURE_PICO2").is_some() {
        return link::link(include_str!("rp2350.x"), &arguments);
    }
    arguments.push("-Tlink-rp.x");
    link::link(include_str!("rp2040.x"), &arguments);
}
