# SPDX-License-Identifier: GPL-3.0-or-later
"""Ours and theirs under one signature: prepare(points, neighbors) -> run() -> normals.

What a library wants as its own kind of cloud is made in `prepare`, which is not
timed; `run` goes from there to normals. Those that can use all cores do: ours, MeshLib,
small_gicp, Open3D and CGAL; PyMeshLab and point-cloud-utils run on one.
"""

import numpy as np

from core import Settings, delaunay_normals, estimate_normals


def _ours(**options):
    def prepare(points, neighbors):
        settings = Settings(**{"neighbors": neighbors, "orientation": "none"} | options)
        return lambda: estimate_normals(points, settings=settings).normals

    return prepare


def _delaunay(points, _neighbors):
    return lambda: delaunay_normals(points)


def _open3d(points, neighbors):
    import open3d

    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    search = open3d.geometry.KDTreeSearchParamKNN(neighbors)

    def run():
        cloud.estimate_normals(search, fast_normal_computation=True)
        return np.asarray(cloud.normals)

    return run


def _small_gicp(points, neighbors):
    import os

    import small_gicp

    cloud = small_gicp.PointCloud(points)

    def run():
        small_gicp.estimate_normals(cloud, None, neighbors, os.cpu_count())
        return np.asarray(cloud.normals())[:, :3]

    return run


def _meshlib(points, neighbors):
    from meshlib import mrmeshnumpy, mrmeshpy

    cloud = mrmeshnumpy.pointCloudFromPoints(points)

    def run():
        radius = mrmeshpy.findAvgPointsRadius(cloud, neighbors)
        normals = mrmeshpy.makeUnorientedNormals(cloud, radius)
        return mrmeshnumpy.toNumpyArray(normals)

    return run


def _pymeshlab(points, neighbors):
    import pymeshlab

    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(points))

    def run():
        meshes.compute_normal_for_point_clouds(k=neighbors, smoothiter=0)
        return meshes.current_mesh().vertex_normal_matrix()

    return run


def _point_cloud_utils(points, neighbors):
    import point_cloud_utils

    def run():
        rows, found = point_cloud_utils.estimate_point_cloud_normals_knn(
            points, neighbors
        )
        normals = np.zeros_like(points)
        normals[rows] = found
        return normals

    return run


def _cgal(name):
    def prepare(points, neighbors):
        from CGAL import CGAL_Point_set_processing_3
        from CGAL.CGAL_Kernel import Point_3
        from CGAL.CGAL_Point_set_3 import Point_set_3

        cloud = Point_set_3()
        cloud.reserve(len(points))
        for point in points.tolist():
            cloud.insert(Point_3(*point))
        estimate = getattr(CGAL_Point_set_processing_3, name)

        def run():
            estimate(cloud, neighbors)
            return lambda: np.array(
                [(n.x(), n.y(), n.z()) for n in map(cloud.normal, cloud.indices())]
            )

        return run

    return prepare


# Name in the tables: module to import, and prepare.
METHODS = {
    "ours": ("core", _ours(method="time_scale")),
    "ours, auto": ("core", _ours(method="auto", neighbors=None)),
    "ours, biquadratic": ("core", _ours(method="time_scale", patch="biquadratic")),
    "ours, Delaunay": ("core", _delaunay),
    "MeshLib": ("meshlib", _meshlib),
    "small_gicp": ("small_gicp", _small_gicp),
    "Open3D": ("open3d", _open3d),
    "PyMeshLab": ("pymeshlab", _pymeshlab),
    "point-cloud-utils": ("point_cloud_utils", _point_cloud_utils),
    "CGAL PCA": ("CGAL", _cgal("pca_estimate_normals")),
    "CGAL jet": ("CGAL", _cgal("jet_estimate_normals")),
}
