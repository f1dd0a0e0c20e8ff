"""S3DIS: a room of two things; a space and a digit have a flipped bit, as in Area_5/hallway_6 and office_19."""

from samples._parts import wall


def write(folder):
    room = folder / "Area_1" / "office_1"
    (room / "Annotations").mkdir(parents=True)
    lines = [" ".join(f"{value:.3f}" for value in point) + f" {row} 0 255" for row, point in enumerate(wall())]
    lines[3] = lines[3].replace(" 0 255", "\x000 255")
    lines[4] = lines[4].replace(" 0 255", " \x10 255")
    for name, part in (("office_1.txt", lines), ("Annotations/chair_1.txt", lines[:15])):
        (room / name).write_text("\n".join(part) + "\n")
    (room / "Annotations" / "wall_1.txt").write_text("\r\n".join(lines[15:]) + "\r\n")
    return room
