//! Whether a mesh is fine enough for the split that is planned on it, in words.
use crate::scenario::Scenario;
use osteotome_anatomy::Patient;
use osteotome_anatomy::osteotomy::{Plan, Situation};
use osteotome_mechanics::geometry::MeshDistance;

/// An element at the line longer than this share of the bone's thickness there leaves a crack no room to choose its way. Measured
/// with the built-in surgeon (docs/patients.md): 0.92 splits well on both sides, 0.96 is in doubt, 1.2 went astray on one.
const COARSE: f64 = 0.94;
/// What is advised instead.
const FINE: f64 = 0.8;
/// A graded mesh whose elements at the line are not shorter than this share of the mean over the whole mesh is an even one.
const UNGRADED: f64 = 0.9;

/// What is to be said of the mesh; `h`: mean edge length near the line \[mm\].
pub fn fineness(s: &Scenario, patient: &Patient, h: f64) -> Vec<String> {
    let (mut remarks, nodes) = (Vec::new(), patient.mesh.nodes().len());
    let thickness = thickness(patient);
    if h > COARSE * thickness {
        remarks.push(format!(
            "the tetrahedra at the line are {h:.1} mm long and the bone there is {thickness:.1} mm thick: a split on this mesh of {nodes} nodes may go astray or not come about; take mesh.nodes = {} or more",
            advised(nodes, h / (FINE * thickness))
        ));
    }
    let mean = patient.mesh.mean_edge_length();
    if s.mesh.file.is_none() && s.mesh.grading > 1.0 && h > UNGRADED * mean {
        remarks.push(format!(
            "mesh.grading = {} made nothing finer: a mesh of {nodes} nodes has none to spare elsewhere ({h:.1} mm at the line, {mean:.1} mm on average); take more nodes, or leave it out",
            s.mesh.grading
        ));
    }
    remarks
}

/// So many nodes make edges shorter by this factor; in round hundreds.
fn advised(nodes: usize, shorter: f64) -> usize {
    let exact = nodes as f64 * shorter.powi(3);
    100 * (exact / 100.0).ceil() as usize
}

/// Of the bone under the saw, where it is thin: a quarter of the line's points have less of it before them \[mm\].
fn thickness(patient: &Patient) -> f64 {
    let review = Plan::of(&patient.osteotomy).review(&Situation {
        surface: &MeshDistance::new(patient.surface.clone()),
        canals: &[],
        cortical_thickness: &|_| 0.0,
    });
    let mut all: Vec<f64> = review.points.iter().map(|p| p.thickness).collect();
    all.sort_by(f64::total_cmp);
    all.get(all.len() / 4).copied().unwrap_or(f64::INFINITY)
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteotome_anatomy::{MeshSource, Parameters, PatientSpec, SurfaceSource};

    fn patient(ramus_thickness: f64, mesh: MeshSource) -> Patient {
        let sizes = Parameters {
            ramus_thickness,
            ..Parameters::default()
        };
        let spec = PatientSpec {
            surface: SurfaceSource::Parametric(sizes),
            mesh,
            shell_points: 2_000,
            ..PatientSpec::default()
        };
        Patient::build(&spec, &mut |_, _| {}).expect("a patient")
    }

    #[test]
    fn a_mesh_as_coarse_as_the_ramus_is_thick_gets_a_word_and_a_number_that_mends_it() {
        let scenario: Scenario =
            toml::from_str(crate::scenario::BSSO_RIGHT).expect("a shipped scenario");
        let said = |thick: f64, nodes: usize| {
            let p = patient(thick, MeshSource::Nodes(nodes));
            let h = super::super::prepare::element_size(&p.mesh, &p.osteotomy);
            fineness(&scenario, &p, h)
        };
        assert_eq!(said(8.0, 600), Vec::<String>::new());
        let thin = said(6.0, 600);
        assert!(thin.len() == 1 && thin[0].contains("mm thick"), "{thin:?}");
        let number = thin[0].split("mesh.nodes = ").nth(1).expect("a number");
        let number: usize = number
            .split(' ')
            .next()
            .and_then(|n| n.parse().ok())
            .expect("a number");
        assert!((1_000..2_500).contains(&number), "{number}");
        assert_eq!(said(6.0, number), Vec::<String>::new());
    }

    #[test]
    fn grading_that_does_nothing_gets_a_word() {
        let mut scenario: Scenario =
            toml::from_str(crate::scenario::BSSO_RIGHT).expect("a shipped scenario");
        scenario.mesh.grading = 3.0;
        let said = |nodes: usize| {
            let p = patient(8.0, MeshSource::Graded { nodes, ratio: 3.0 });
            let h = super::super::prepare::element_size(&p.mesh, &p.osteotomy);
            fineness(&scenario, &p, h).join("; ")
        };
        let few = said(600);
        assert!(few.contains("mesh.grading = 3 made nothing finer"), "{few}");
        assert_eq!(said(4_000), "");
    }
}
