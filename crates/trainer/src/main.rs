//! The program `osteotome`.
mod scenario;
fn main() {}
