//! The surgeon's tools: their shape, their springs to the hands, and where they come to rest (paper 3.2, 3.3).
mod bone_compliance;
mod chisel;
mod coupling;
mod equilibrium;
mod solve;

pub use bone_compliance::BoneCompliance;
pub use chisel::{Chisel, ChiselError, ChiselParameters};
pub use coupling::{Coupling, CouplingError, CouplingResponse};
pub use equilibrium::{
    ScratchLimits, SolveSettings, Tool, ToolInput, ToolModel, ToolScratch, ToolsResult, ToolsState,
    evaluate_contacts, solve_tools, solve_tools_on_threads,
};
pub use solve::{Matrix12, Vector12, bounded_step};
