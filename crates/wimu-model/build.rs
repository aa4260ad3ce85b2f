fn main() {
    println!("cargo::rustc-check-cfg=cfg(no_long_multiply)");
    if std::env::var("TARGET").is_ok_and(|t| t.starts_with("thumbv6m")) {
        println!("cargo::rustc-cfg=no_long_multiply");
    }
}
