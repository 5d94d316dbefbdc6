#!/usr/bin/env python3
"""Osteotome beside programs that do one of its parts for a living. Run by hand, on a quiet machine:

    cargo build --release
    target/release/osteotome bench --nodes 5000 --export /tmp/peers
    pip install scikit-sparse coal          # SuiteSparse and OpenBLAS from the distribution
    python3 benches/peers/peers.py /tmp/peers

CHOLMOD factors and solves the same stiffness on our ordering and on its own best one; coal (the successor of FCL) looks for
contacts of the same chisels on the same poses against the same surface. Both run on one thread, as ours does. GetFEM cuts,
assembles and solves a cracked block in validation/peers/getfem_levelset.py, which times both programs.
"""
import json
import os
import sys
import time
from importlib.metadata import version
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import coal
import numpy as np
import scipy.io
import scipy.sparse
from sksparse import cholmod

REPEATS = 5


def least(work):
    """Result and least time of several calls [ms]."""
    best, result = float("inf"), None
    for _ in range(REPEATS):
        start = time.perf_counter()
        result = work()
        best = min(best, time.perf_counter() - start)
    return result, 1e3 * best


def equations(folder, ours):
    """CHOLMOD on the same stiffness."""
    matrix = scipy.sparse.csc_matrix(scipy.io.mmread(folder / "stiffness.mtx"))
    order = np.loadtxt(folder / "ordering.txt", dtype=int)
    rhs = np.ones(matrix.shape[0])
    print(f"CHOLMOD (scikit-sparse {version('scikit-sparse')}), {matrix.shape[0]} unknowns, {matrix.nnz} entries")
    print("| | ordering + analysis [ms] | numbers [ms] | all [ms] | of ours | solve [ms] | of ours | values |")
    print("|---|---|---|---|---|---|---|---|")
    print(f"| ours | | | {ours['factor_ms']:.2f} | 1 | {ours['solve_ms']:.3f} | 1 | {ours['factor_values']} |")
    permuted = matrix[order][:, order].tocsc()
    permuted.sort_indices()
    cases = [("CHOLMOD, our ordering", permuted, "natural"), ("CHOLMOD, its METIS", matrix, "metis"),
             ("CHOLMOD, its AMD", matrix, "amd")]
    for name, a, ordering in cases:
        factor, analysis = least(lambda: cholmod.analyze(a, mode="supernodal", ordering_method=ordering))
        _, numbers = least(lambda: factor.cholesky_inplace(a))
        x, solve = least(lambda: factor.solve_A(rhs))
        residual = np.abs(a @ x - rhs).max()
        if residual > 1e-6:
            sys.exit(f"{name}: the residual is {residual:.1e}")
        both = analysis + numbers
        print(f"| {name} | {analysis:.2f} | {numbers:.2f} | {both:.2f} | {both / ours['factor_ms']:.2f} "
              f"| {solve:.3f} | {solve / ours['solve_ms']:.2f} | {factor.L().nnz} |")


def read_obj(path):
    """A triangle surface for coal."""
    lines = [line.split() for line in path.read_text().splitlines()]
    vertices = np.array([[float(v) for v in w[1:]] for w in lines if w[0] == "v"])
    triangles = np.array([[int(v) - 1 for v in w[1:]] for w in lines if w[0] == "f"])
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(triangles), len(vertices))
    all_vertices = coal.StdVec_Vec3s()
    all_vertices.extend(list(vertices))
    all_triangles = coal.StdVec_Triangle()
    all_triangles.extend([coal.Triangle(*map(int, t)) for t in triangles])
    model.addSubModel(all_vertices, all_triangles)
    model.endModel()
    return model, len(triangles)


def pose(form):
    """Of a position and a quaternion x, y, z, w."""
    position, (x, y, z, w) = form
    turned = coal.Quaternion(w, x, y, z) if hasattr(coal, "Quaternion") else None
    if turned is None:
        rotation = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
        return coal.Transform3s(rotation, np.array(position))
    return coal.Transform3s(turned, np.array(position))


def contacts(folder, ours):
    """coal on the same poses. It sees the bone's surface at rest: neither saw cut nor crack nor deformation, and it gives pairs of
    triangles, not depths of points."""
    bone, faces = read_obj(folder / "surface.obj")
    chisels = [read_obj(folder / f"chisel_{i}.obj")[0] for i in range(2)]
    request = coal.CollisionRequest(coal.CollisionRequestFlag.CONTACT, 100_000)
    touching = [t for t in ours["touches"] if t["contacts"] > 0]
    theirs, mine, pairs = [], [], []
    for touch in touching:
        def query():
            found = 0
            for chisel, form in zip(chisels, touch["tools"]):
                result = coal.CollisionResult()
                coal.collide(bone, coal.Transform3s.Identity(), chisel, pose(form), request, result)
                found += result.numContacts()
            return found
        found, ms = least(query)
        theirs.append(ms)
        mine.append(touch["query_ms"])
        pairs.append(found)
    if not touching:
        sys.exit("no pose of the export touches the bone")
    print(f"\ncoal {version('coal')}: {faces} triangles against two chisels, {len(touching)} poses that touch")
    print("| | mean [ms] | largest [ms] | contacts, mean |")
    print("|---|---|---|---|")
    points = np.mean([t["contacts"] for t in touching])
    print(f"| ours, deformed bone with its crack, single calls | {np.mean(mine):.4f} | {np.max(mine):.4f} | {points:.0f} points |")
    print(f"| coal, surface at rest, least of {REPEATS} | {np.mean(theirs):.4f} | {np.max(theirs):.4f} | {np.mean(pairs):.0f} pairs |")
    print(f"Ratio of means: {np.mean(theirs) / np.mean(mine):.1f}")


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    folder = Path(sys.argv[1])
    ours = json.loads((folder / "ours.json").read_text())
    equations(folder, ours)
    contacts(folder, ours)


if __name__ == "__main__":
    main()
