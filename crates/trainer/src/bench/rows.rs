//! What is timed, and what the paper says of it.
use super::times::{Pairs, Times};

/// The parts of Table 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Both tools to rest between hands and bone.
    HapticStep,
    /// Bone and tools to rest together.
    MainStep,
    /// The bone's points inside both tools.
    CollisionQuery,
    /// Cells' matrices and volumes follow the bone.
    CollisionUpdate,
    /// The drawn surfaces follow bone and crack.
    VisualUpdate,
    /// One picture.
    CsgRender,
    /// A look at all fronts, and the growth that may follow.
    PropagationStep,
    /// That without the equations of what grew.
    CrackPropagation,
    /// Stiffness of what a growth adds.
    Linearisation,
    /// Factor of it.
    Factorisation,
}

use Part::{
    CollisionQuery, CollisionUpdate, CrackPropagation, CsgRender, Factorisation, HapticStep,
    Linearisation, MainStep, PropagationStep, VisualUpdate,
};

impl Part {
    /// As in the contract.
    pub fn name(self) -> &'static str {
        match self {
            HapticStep => "haptic step",
            MainStep => "main step",
            CollisionQuery => "collision query",
            CollisionUpdate => "collision update",
            VisualUpdate => "visual update",
            CsgRender => "csg render",
            PropagationStep => "propagation step",
            CrackPropagation => "crack propagation",
            Linearisation => "linearisation",
            Factorisation => "factorisation",
        }
    }

    /// Mean, standard deviation, least and most in the paper's Table 1 \[ms\].
    pub fn paper(self) -> [f64; 4] {
        match self {
            HapticStep => [0.45, 0.16, 0.08, 0.95],
            MainStep => [4.33, 1.27, 3.32, 15.93],
            CollisionQuery => [0.43, 0.17, 0.00, 0.89],
            CollisionUpdate => [2.20, 0.34, 1.84, 3.22],
            VisualUpdate => [0.24, 0.05, 0.17, 0.44],
            CsgRender => [1.81, 0.21, 1.11, 2.51],
            PropagationStep => [9.45, 15.46, 0.12, 122.94],
            CrackPropagation => [7.85, 13.79, 0.10, 75.33],
            Linearisation => [65.92, 12.84, 41.24, 83.27],
            Factorisation => [8.41, 1.43, 6.32, 10.96],
        }
    }
}

/// What was measured of one part.
#[derive(Clone, Debug)]
pub struct Row {
    /// Which.
    pub part: Part,
    /// Each time that it was done.
    pub times: Times,
    /// Held against other ways to do it; the first is the paper's.
    pub baselines: Vec<Pairs>,
}

impl Row {
    /// A part without a baseline.
    pub fn new(part: Part, times: Times) -> Self {
        Self {
            part,
            times,
            baselines: Vec::new(),
        }
    }

    /// With a baseline.
    pub fn against(mut self, baseline: Pairs) -> Self {
        self.baselines.push(baseline);
        self
    }
}
