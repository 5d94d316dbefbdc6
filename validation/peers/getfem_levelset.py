#!/usr/bin/env python3
"""The same cracked block by `osteotome fracture` and by GetFEM's level-set XFEM: strain energies must agree to six digits.

    apt-get install python3-getfem          # Debian: GetFEM 5.4
    cargo build --release
    /usr/bin/python3 validation/peers/getfem_levelset.py target/release/osteotome

A block of bricks cut into six tetrahedra each, inner nodes moved at random, clamped below and moved as a whole above. The plane
of the crack lies anywhere between the nodes; the crack ends on the element faces x = END, so that both codes cut exactly the
elements with all nodes at x <= END that the plane crosses. Osteotome cuts the elements whose polygon's centre lies less than
.52 h ahead of the geometric front: its front is put behind END, in steps of .05 mm, to where it enriches as many nodes as GetFEM.

The spaces coincide: GetFEM gives a node one function for each connected zone of its support, osteotome u_i and one jump for each
component beyond the node's own. They would differ where a front ends inside an element (GetFEM cuts it up to the front,
osteotome wholly or not at all) and where nodes lie closer than .05 h to the crack (osteotome moves them off it); the case avoids
both and says so if it does not.
"""
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import getfem as gf
import numpy as np

YOUNG, POISSON = 1000.0, 0.3
SIZE = (12.0, 4.0, 10.0)
CELLS = (12, 4, 10)
END = 7.0  # x of the element faces on which the crack ends
TOP = (0.03, 0.02, 0.1)  # displacement of the top
SIX = [(0, 1, 3, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7), (0, 4, 5, 7), (0, 5, 1, 7)]


def block(seed, slope):
    """Nodes and tetrahedra; inner nodes moved by up to .12 of the spacing, those at x = END within that plane only, and sheared
    with the crack's plane, so that it passes between them."""
    n = np.array(CELLS) + 1
    grid = np.stack(np.meshgrid(*[np.arange(k) for k in n], indexing="ij"), -1).reshape(-1, 3)
    step = np.array(SIZE) / np.array(CELLS)
    random = np.random.default_rng(seed).uniform(-0.12, 0.12, grid.shape)
    inner = (grid > 0) & (grid < np.array(CELLS))
    inner[:, 0] &= np.abs(grid[:, 0] * step[0] - END) > 1e-9
    nodes = (grid + random * inner) * step
    nodes[:, 2] += slope * nodes[:, 0] * (1.0 - np.abs(nodes[:, 2] - 5.0) / 5.0)
    number = lambda p: (p[..., 0] * n[1] + p[..., 1]) * n[2] + p[..., 2]
    first = grid[(grid < np.array(CELLS)).all(1)]
    corner = [number(first + np.array([i & 1, i >> 1 & 1, i >> 2 & 1])) for i in range(8)]
    tets = np.concatenate([np.stack([corner[i] for i in six], 1) for six in SIX])
    sides = nodes[tets]
    volume = np.linalg.det(sides[:, 1:] - sides[:, :1])
    tets[volume < 0] = tets[volume < 0][:, [0, 2, 1, 3]]
    return nodes, tets


def plane(slope):
    """Signed distance to the crack's plane z = 5.27 + slope x."""
    return lambda p: (p[:, 2] - 5.27 - slope * p[:, 0]) / np.hypot(1.0, slope)


def osteotome(binary, folder, nodes, tets, slope, end):
    """Energy and enriched nodes of the block by `osteotome fracture`, the geometric front at x = `end`; and milliseconds, reading
    the case and evaluating the front included."""
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$Nodes", str(len(nodes))]
    lines += [f"{i + 1} {x!r} {y!r} {z!r}" for i, (x, y, z) in enumerate(nodes.tolist())]
    lines += ["$EndNodes", "$Elements", str(len(tets))]
    lines += [f"{i + 1} 4 2 1 1 {a + 1} {b + 1} {c + 1} {d + 1}" for i, (a, b, c, d) in enumerate(tets.tolist())]
    (folder / "mesh.msh").write_text("\n".join(lines + ["$EndElements", ""]))
    at = lambda x, y: f"v {x} {y} {5.27 + slope * x}"
    corners = [at(x, y) for x, y in [(-1.0, -1.0), (end, -1.0), (end, 5.0), (-1.0, 5.0)]]
    (folder / "crack.obj").write_text("\n".join(corners + ["f 1 2 3", "f 1 3 4", ""]))
    held = lambda box, fix: f"[[support]]\nwhere = {{ box = {box} }}\nfix = {fix}\n"
    (folder / "case.toml").write_text(
        'units = "mm-N-MPa"\n[mesh]\nfile = "mesh.msh"\n[[material]]\nregion = "*"\n'
        f"young_modulus = {YOUNG}\npoisson_ratio = {POISSON}\n"
        '[crack]\nsurface = "crack.obj"\n'
        + held([[-1, -1, -1], [13, 5, 0]], "{ x = 0.0, y = 0.0, z = 0.0 }")
        + held([[-1, -1, 10], [13, 5, 11]], "{{ x = {}, y = {}, z = {} }}".format(*TOP))
    )
    run = subprocess.run(
        [binary, "fracture", folder / "case.toml", "--out", folder / "result", "--json"],
        capture_output=True, text=True)
    if run.returncode:
        sys.exit(run.stderr)
    result = json.loads(run.stdout)
    timing = result["timing_ms"]
    return result["strain_energy"], result["enriched_nodes"], timing["setup"] + timing["evaluate"]


def getfem(nodes, tets, phi):
    """Energy and further functions of the same block by GetFEM; and milliseconds from the level set to the solution."""
    mesh = gf.Mesh("empty", 3)
    mesh.add_convex(gf.GeoTrans("GT_PK(3,1)"), nodes[tets].transpose(2, 1, 0))
    linear = gf.MeshFem(mesh)
    linear.set_fem(gf.Fem("FEM_PK(3,1)"))
    begin = time.perf_counter()
    level = gf.LevelSet(mesh, 1, "ws")
    points = level.mf().basic_dof_nodes().T
    level.set_values(phi(points), points[:, 0] - END)
    cut = gf.MeshLevelSet(mesh)
    cut.add(level)
    cut.adapt()
    field = gf.MeshFem("levelset", cut, linear)
    further = field.nbdof() - linear.nbdof()
    field.set_qdim(3)
    rule = gf.Integ("IM_TETRAHEDRON(2)")
    integrals = gf.MeshIm("levelset", cut, "all", rule)
    integrals.set_integ(rule)
    values = gf.MeshFem(mesh, 3)
    values.set_fem(gf.Fem("FEM_PK(3,1)"))
    model = gf.Model("real")
    model.add_fem_variable("u", field)
    model.add_initialized_data("lambda", [YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))])
    model.add_initialized_data("mu", [YOUNG / (2 * (1 + POISSON))])
    model.add_isotropic_linearized_elasticity_brick(integrals, "u", "lambda", "mu")
    outer = mesh.outer_faces()
    for region, (height, moved) in enumerate([(0.0, (0.0, 0.0, 0.0)), (SIZE[2], TOP)], 1):
        on = [all(abs(mesh.pts(mesh.pid_in_faces(f.reshape(2, 1)))[2] - height) < 1e-9) for f in outer.T]
        mesh.set_region(region, outer[:, on])
        model.add_initialized_data(f"moved{region}", moved)
        model.add_Dirichlet_condition_with_multipliers(integrals, "u", values, region, f"moved{region}")
    model.solve("max_res", 1e-12)
    ms = 1e3 * (time.perf_counter() - begin)
    u = model.variable("u")
    lame = [model.variable(k)[0] * np.ones(linear.nbdof()) for k in ("lambda", "mu")]
    stiffness = gf.asm_linear_elasticity(integrals, field, linear, *lame)
    return 0.5 * u @ stiffness.mult(u), further, ms


def main():
    gf.util_trace_level(0)
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    print("| case | nodes | osteotome [N mm] | GetFEM [N mm] | difference | further functions | osteotome [ms] | GetFEM [ms] | ratio |")
    print("|---|---|---|---|---|---|---|---|---|")
    worst = 0.0
    for name, seed, slope in [("level plane", 1, 0.0), ("inclined plane", 2, 0.13), ("steeper, other nodes", 7, -0.31)]:
        nodes, tets = block(seed, slope)
        phi = plane(slope)
        distance = np.abs(phi(nodes)[nodes[:, 0] < END + 1.0]).min()
        if distance < 0.05 * 1.4:
            sys.exit(f"{name}: a node lies {distance:.3f} mm from the plane, where osteotome would move it off")
        theirs, further, their_ms = getfem(nodes, tets, phi)
        binary = Path(sys.argv[1]).resolve()
        for end in np.arange(END - 1.4, END - 0.6, 0.05):
            with tempfile.TemporaryDirectory() as folder:
                ours, enriched, our_ms = osteotome(binary, Path(folder), nodes, tets, slope, end)
            if enriched >= further:
                break
        if enriched != further:
            sys.exit(f"{name}: {enriched} enriched nodes against {further}: the two cut different elements")
        worst = max(worst, abs(ours / theirs - 1.0))
        print(f"| {name} | {len(nodes)} | {ours:.9f} | {theirs:.9f} | {ours / theirs - 1.0:+.1e} | {further} "
              f"| {our_ms:.1f} | {their_ms:.1f} | {their_ms / our_ms:.1f} |")
    if worst > 1e-6:
        sys.exit(f"the energies differ by {worst:.1e}; they must agree to 1e-6")


if __name__ == "__main__":
    main()
