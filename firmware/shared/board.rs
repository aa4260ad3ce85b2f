//! The build script of a board whose memory is in its `memory.x`.

mod link;

fn main() {
    // `--icf=all`: functions with the same code exist once.
    let mut arguments = vec!["--nmagic", "--icf=all", "-Tlink.x"];
    if std::env::var_os("CARGO_FEATURE_DEFMT").is_some() {
        arguments.push("-Tdefmt.x");
    }
    link::link(include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/memory.x")), &arguments);
}
