//! A penny-shaped crack held open by a ring of force pairs close to its front, as chisels do: the loads act inside the domain
//! of the integrals.
//!
//! Closed form for forces P in all on each face at radius b of a penny of radius a (from the pressure solution
//! K_I = 2 / sqrt(pi a) int p r / sqrt(a2 - r2) dr): K_I = P / (pi a)^(3/2) / sqrt(1 - b2/a2).
mod support;
use osteotome_mechanics::crack::stress_intensity::Station;
use osteotome_mechanics::geometry::Vec3;
use std::f64::consts::PI;
use support::cracked::*;

const RADIUS: f64 = 3.0;
const NU: f64 = 0.3;
const YOUNG: f64 = 1000.0;

/// Measured with a/h = 3 and 4 in two meshes each, K_I over the closed form as mean +- sd round the front: 1.02 to 1.08 +- .07
/// for forces 1 to 2 h behind the front, 1.06 to 1.11 +- .09 at .6 and .8 h, up to 1.6 closer than .4 h, where the mesh cannot
/// tell the distance. G of the same stations goes by K; by the domain J it was -1.2 to +1.7 +- 1 of the closed form, for any
/// distance: the loads' own strain drowns it. Limit: 12 % for K_I from .6 h on; G twice that.
#[test]
fn forces_near_the_front() {
    const A_OVER_H: f64 = 4.0;
    let step = RADIUS / A_OVER_H / 0.91;
    let even_up_to = |x: f64| (x / step).ceil() * step;
    let (near, flat) = (even_up_to(1.7 * RADIUS), even_up_to(0.8 * RADIUS));
    let wide = graded(near, 5.0 * RADIUS, step, 1.5);
    let high = graded(flat, 5.0 * RADIUS, step, 1.5);
    let mesh = centred_block([&wide, &wide, &high], 0.12, 0);
    let corner = Vec3::new(near, near, flat);
    let h = element_size(&mesh, [-corner, corner]);
    let specimen = Specimen::new(mesh, YOUNG, NU, 1.0, h);
    let centre = Vec3::new(0.1, -0.05, 0.07);
    let disc = ellipse(centre, Vec3::x() * RADIUS, Vec3::y() * RADIUS, 48);
    let body = specimen.cut(vec![disc]);
    let front = body.fronts().remove(0);
    for behind in [0.6, 1.0, 1.5, 2.0] {
        let b = RADIUS - behind * h;
        let solved = body.solve(body.ring(centre, b, 48));
        let stations = body.stations(&solved, &front);
        let k1 = 1.0 / (PI * RADIUS).powf(1.5) / (1.0 - (b / RADIUS).powi(2)).sqrt();
        let g = k1 * k1 * (1.0 - NU * NU) / YOUNG;
        let mean = |f: &dyn Fn(&Station) -> f64| {
            stations.iter().map(f).sum::<f64>() / stations.len() as f64
        };
        let (k1, g) = (mean(&|s| s.k.k1) / k1, mean(&|s| s.g) / g);
        assert!((k1 - 1.0).abs() < 0.12, "{behind} h behind: K_I {k1}");
        assert!((g - 1.0).abs() < 0.24, "{behind} h behind: G {g}");
    }
}
