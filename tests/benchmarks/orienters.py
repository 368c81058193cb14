# SPDX-License-Identifier: GPL-3.0-or-later
"""Ours and theirs under one signature: oriented normals of points alone.

    method(points, mark) -> (n, 3)

`mark()` is called when the library has the points in its own form, and again when the
normals are oriented; what comes before and after is not timed. All look at 16
neighbors where they are to be told a number, and otherwise have their defaults.
"""

import numpy as np

from core import estimate_normals

NEIGHBORS = 16


def ours(points, mark):
    mark()
    normals = estimate_normals(points).normals
    mark()
    return normals


def open3d(points, mark):
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    mark()
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(NEIGHBORS))
    cloud.orient_normals_consistent_tangent_plane(NEIGHBORS)
    mark()
    return np.asarray(cloud.normals)


def meshlib(points, mark):
    from meshlib import mrmeshnumpy, mrmeshpy

    cloud = mrmeshnumpy.pointCloudFromPoints(points)
    mark()
    radius = mrmeshpy.findAvgPointsRadius(cloud, NEIGHBORS)
    found = mrmeshpy.makeOrientedNormals(cloud, radius)
    mark()
    return mrmeshnumpy.toNumpyArray(found)


def pymeshlab(points, mark):
    import pymeshlab as ml

    meshes = ml.MeshSet(verbose=False)
    meshes.add_mesh(ml.Mesh(points))
    mark()
    meshes.compute_normal_for_point_clouds(k=NEIGHBORS)
    mark()
    return meshes.current_mesh().vertex_normal_matrix()


def vtk(points, mark):
    import vtk
    from vtk.util import numpy_support

    places = vtk.vtkPoints()
    places.SetData(numpy_support.numpy_to_vtk(points, deep=True))
    cloud = vtk.vtkPolyData()
    cloud.SetPoints(places)
    found = vtk.vtkPCANormalEstimation()
    found.SetInputData(cloud)
    found.SetSampleSize(NEIGHBORS)
    found.SetNormalOrientationToGraphTraversal()
    mark()
    found.Update()
    mark()
    normals = found.GetOutput().GetPointData().GetNormals()
    return numpy_support.vtk_to_numpy(normals)


def cgal(points, mark):
    from CGAL import CGAL_Point_set_processing_3
    from CGAL.CGAL_Kernel import Point_3
    from CGAL.CGAL_Point_set_3 import Point_set_3

    cloud = Point_set_3()
    cloud.reserve(len(points))
    for point in points.tolist():
        cloud.insert(Point_3(*point))
    mark()
    CGAL_Point_set_processing_3.jet_estimate_normals(cloud, NEIGHBORS)
    CGAL_Point_set_processing_3.mst_orient_normals(cloud, NEIGHBORS)
    mark()
    # Points it is unsure of go to the end, under the numbers they had.
    normals = np.zeros_like(points)
    for index in cloud.indices():
        normal = cloud.normal(index)
        normals[index] = normal.x(), normal.y(), normal.z()
    return normals


# Name in the tables: module to import, and method.
METHODS = {
    "ours": ("core", ours),
    "Open3D": ("open3d", open3d),
    "MeshLib": ("meshlib", meshlib),
    "PyMeshLab": ("pymeshlab", pymeshlab),
    "VTK": ("vtk", vtk),
    "CGAL jet, MST": ("CGAL", cgal),
}
