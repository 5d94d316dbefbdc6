//! Builds the stand-ins from their C sources. Free of unsafe code, so that the program's tests can use it too.
use std::path::{Path, PathBuf};
use std::process::Command;

/// Builds `NAME.c` beside this file into `folder`.
pub fn build(name: &str, folder: &Path) -> PathBuf {
    let source =
        Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../devices/tests/standin/{name}.c"));
    let library = folder.join(format!("{name}.so"));
    let status = Command::new("cc")
        .args([
            "-std=gnu11",
            "-O1",
            "-Wall",
            "-Wextra",
            "-Werror",
            "-shared",
            "-fPIC",
            "-pthread",
        ])
        .arg("-o")
        .args([&library, &source])
        .arg("-lm")
        .status()
        .expect("cc runs");
    assert!(status.success(), "{name}.c does not build");
    library
}
