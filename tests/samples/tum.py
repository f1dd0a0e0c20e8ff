"""TUM RGB-D: two images, two depth images, a trajectory, and a cloud."""

from samples._parts import wall, write_depth, write_noise, write_ply


def write(folder):
    scene = folder / "rgbd_dataset_freiburg1_tiny"
    scene.mkdir()
    rgb, depth = ["# color images", "# timestamp filename"], ["# depth maps", "# timestamp filename"]
    for index, time in enumerate((1305031102.175304, 1305031102.211214)):
        write_noise(scene / "rgb" / f"{time:.6f}.png", index)
        write_depth(scene / "depth" / f"{time - 0.0147:.6f}.png", 10000)
        rgb.append(f"{time:.6f} rgb/{time:.6f}.png")
        depth.append(f"{time - 0.0147:.6f} depth/{time - 0.0147:.6f}.png")
    (scene / "rgb.txt").write_text("\n".join(rgb) + "\n")
    (scene / "depth.txt").write_text("\n".join(depth) + "\n")
    poses = ["# timestamp tx ty tz qx qy qz qw"]
    poses += [f"{1305031102.17 + step / 100:.4f} {step / 100:.4f} 0.0 0.0 0.6 0.0 0.0 -0.8" for step in range(6)]
    (scene / "groundtruth.txt").write_text("\n".join(poses) + "\n")
    write_ply(scene / "cloud.ply", wall())
    return scene
