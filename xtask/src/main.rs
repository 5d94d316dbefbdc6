//! Project chores: `cargo run -p xtask -- meshes` writes the meshes and cracks of `validation/`,
//! `cargo run --release -p xtask -- validation` solves them and writes `docs/validation.md`,
//! `cargo run -p xtask -- scaling nodes a.json b.json` (or `points`) draws `docs/performance/` from runs of `osteotome bench --json`,
//! `cargo run --release -p xtask -- jaw-split SCENARIO kept|driven OUT` splits a jaw under force pairs.
#[expect(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a chore talks to whoever runs it"
)]
mod jaw_split;
mod meshes;
mod scaling;
mod validation;

use anyhow::{Result, bail};

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["meshes"] => meshes::write_all(),
        ["validation"] => validation::write(),
        ["jaw-split", ..] => jaw_split::run(&arguments[1..]),
        ["scaling", what, ..] => scaling::write(what, &arguments[2..]),
        _ => bail!(
            "give a chore: meshes, validation, scaling nodes|points FILE..., or jaw-split SCENARIO kept|driven OUT"
        ),
    }
}
