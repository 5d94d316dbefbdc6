//! What is known of devices by model: plain data, for binding, for clamps and for judging stability.

/// A device model's limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviceModel {
    /// As it is named in lists.
    pub name: &'static str,
    /// Peak force \[N\].
    pub max_force: f64,
    /// Force that it bears without end \[N\], where known.
    pub continuous_force: Option<f64>,
    /// Peak torque \[N mm\]; 0: it has none.
    pub max_torque: f64,
    /// Stiffest spring that its maker recommends \[N/mm\], where known.
    pub nominal_stiffness: Option<f64>,
    /// Sensed degrees of freedom.
    pub dofs_in: u8,
    /// Driven degrees of freedom.
    pub dofs_out: u8,
}

const fn model(name: &'static str, dofs: [u8; 2], force: f64, torque: f64) -> DeviceModel {
    DeviceModel {
        name,
        max_force: force,
        continuous_force: None,
        max_torque: torque,
        nominal_stiffness: None,
        dofs_in: dofs[0],
        dofs_out: dofs[1],
    }
}

impl DeviceModel {
    const fn stiffness(mut self, n_per_mm: f64) -> Self {
        self.nominal_stiffness = Some(n_per_mm);
        self
    }
    const fn continuous(mut self, force: f64) -> Self {
        self.continuous_force = Some(force);
        self
    }
    /// The model of this name, whatever its case.
    pub fn by_name(name: &str) -> Option<&'static Self> {
        MODELS.iter().find(|m| m.name.eq_ignore_ascii_case(name))
    }
}

/// Phantom Omni.
pub const OMNI: DeviceModel = model("Phantom Omni", [6, 3], 3.3, 0.0)
    .stiffness(0.7)
    .continuous(0.88);
/// 3D Systems Touch.
pub const TOUCH: DeviceModel = model("Touch", [6, 3], 3.3, 0.0).stiffness(0.4);
/// The paper's device with torque.
pub const PREMIUM_6DOF: DeviceModel =
    model("Phantom Premium 1.5/6DOF", [6, 6], 8.5, 188.0).stiffness(0.8);
/// Force Dimension omega without a wrist.
pub const OMEGA_3: DeviceModel = model("omega.3", [3, 3], 12.0, 0.0).stiffness(5.0);
/// Force Dimension omega with a sensed wrist.
pub const OMEGA_6: DeviceModel = model("omega.6", [6, 3], 12.0, 0.0).stiffness(5.0);
/// Force Dimension sigma.7; its seventh degree of freedom is the grip.
pub const SIGMA_7: DeviceModel = model("sigma.7", [7, 7], 12.0, 200.0).stiffness(4.0);
/// Force Dimension lambda.7; its seventh degree of freedom is the grip.
pub const LAMBDA_7: DeviceModel = model("lambda.7", [7, 7], 12.0, 200.0).stiffness(8.0);
/// Haply Inverse3 with its grip; about 10 N.
pub const INVERSE_3: DeviceModel = model("Inverse3", [6, 3], 10.0, 0.0);

/// All of them. Peaks and stiffnesses: the device tables of CHAI3D; Omni's continuous force and Inverse3: their makers.
pub const MODELS: [DeviceModel; 8] = [
    OMNI,
    TOUCH,
    PREMIUM_6DOF,
    OMEGA_3,
    OMEGA_6,
    SIGMA_7,
    LAMBDA_7,
    INVERSE_3,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_model_is_found_by_its_name_and_consistent() {
        for m in &MODELS {
            assert_eq!(DeviceModel::by_name(&m.name.to_uppercase()), Some(m));
            assert!(m.continuous_force.is_none_or(|f| f < m.max_force));
            assert_eq!(m.max_torque > 0.0, m.dofs_out >= 6, "{}", m.name);
        }
    }
}
