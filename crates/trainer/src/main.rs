//! The program `osteotome`.
fn main() {}
