//! Project chores: `cargo run -p xtask -- meshes` writes the meshes and cracks of `validation/`,
//! `cargo run --release -p xtask -- validation` solves them and writes `docs/validation.md`.
mod meshes;
mod validation;

use anyhow::{Result, bail};

fn main() -> Result<()> {
    match std::env::args().nth(1).as_deref() {
        Some("meshes") => meshes::write_all(),
        Some("validation") => validation::write(),
        _ => bail!("give a chore: meshes or validation"),
    }
}
