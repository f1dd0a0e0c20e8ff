"""COLMAP, text: two images of two camera models, sparse points with tracks."""

from samples._parts import HEIGHT, WIDTH, wall, write_noise


def write(folder):
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    cameras = ["# Camera list with one line of data per camera:", "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    cameras += [f"3 SIMPLE_RADIAL {WIDTH} {HEIGHT} 20.5 8 6 0.05", f"1 PINHOLE {WIDTH} {HEIGHT} 20 21 8 6"]
    (model / "cameras.txt").write_text("\n".join(cameras) + "\n")
    images = ["# Image list with two lines of data per image:", "# Number of images: 2"]
    for index, (camera, points) in enumerate(((3, "4.5 3.25 63390 9 9 -1"), (1, ""))):
        write_noise(folder / "images" / f"left {index}.png", index)
        images += [f"{5 - index} 0.8 0.6 0 0 {-0.1 * index:.1f} 0.5 0.25 {camera} left {index}.png", points]
    (model / "images.txt").write_text("\n".join(images) + "\n")
    points = ["# 3D point list with one line of data per point:"]
    points += [f"{63390 + i} {x} {y} {z} 115 121 {i} 1.33927 5 0 4 0" for i, (x, y, z) in enumerate(wall())]
    (model / "points3D.txt").write_text("\n".join(points) + "\n")
    return folder
