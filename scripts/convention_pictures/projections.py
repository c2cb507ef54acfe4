"""Draws pictures of cameras: kinds, principal point, and depth in clip space."""

import numpy as np
from PIL import Image, ImageDraw

from convention_pictures.room import room
from convention_pictures.sketch import BLUE, FAINT, INK, RED, beside, drawn, paper, scene_of, write
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera


def camera_kinds(renderer: Renderer) -> Image.Image:
    """Draw a scene by a pinhole, an orthographic camera and a panorama."""
    scene = scene_of(room())
    pinhole = Camera.look_at((-0.9, -1.1, -3.2), (0.1, 0.2, 1.6), width=330, height=240, fov_y=56)
    flat = pinhole.flattened(5.2)
    around = Camera.panorama((0.0, -0.3, 0.0), width=672, height=336)
    two = beside([drawn(renderer, scene, pinhole), drawn(renderer, scene, flat)])
    panorama_image = drawn(renderer, scene, around)
    image = paper(two.width, two.height + panorama_image.height + 66)
    image.paste(two, (0, 26))
    image.paste(panorama_image, (0, two.height + 58))
    write(image, (165, 13), 'kind "pinhole"')
    write(image, (507, 13), 'kind "orthographic"')
    write(image, (336, two.height + 43), 'kind "panorama", from the middle of the floor')
    for degrees in (-180, -90, 0, 90, 180):
        x = 336 + 336 * degrees / 180
        label_x = min(max(x, 24), 648)
        write(image, (label_x, two.height + 58 + 322), f"{degrees}°", INK, 14)
    return image


def principal_point(renderer: Renderer) -> Image.Image:
    """Draw a scene with the principal point in the middle of the image, and beside it."""
    scene = scene_of(room())
    base = Camera.look_at((-0.9, -1.1, -3.2), (0.1, 0.2, 1.6), width=330, height=240, fov_y=56)
    pictures = []
    for cx, cy in ((165.0, 120.0), (235.0, 70.0)):
        camera = Camera(base.view, fx=base.fx, fy=base.fy, cx=cx, cy=cy, width=330, height=240)
        picture = drawn(renderer, scene, camera)
        pen = ImageDraw.Draw(picture)
        pen.line([(cx, 0), (cx, 240)], fill=RED)
        pen.line([(0, cy), (330, cy)], fill=RED)
        pen.ellipse([cx - 4, cy - 4, cx + 4, cy + 4], outline=RED, width=2)
        write(picture, (8, 14), f"cx {cx:g}, cy {cy:g} in 330 x 240", RED, 15, "lm")
        pictures.append(picture)
    return beside(pictures)


def clip_depth(renderer: Renderer) -> Image.Image:
    """Draw the depth in clip space over z, from the near plane to the far plane."""
    image, x0, top, width, high = paper(560, 260), 56, 24, 470, 180
    pen = ImageDraw.Draw(image)
    near, far = 0.5, 8.0
    for share in (0.0, 0.5, 1.0):
        y = top + high * (1 - share)
        pen.line([(x0, y), (x0 + width, y)], fill=FAINT)
        write(image, (x0 - 10, y), f"{share:g}", INK, 14, "rm")
    for z in (near, 1, 2, 4, far):
        x = x0 + width * z / 9
        pen.line([(x, top), (x, top + high)], fill=FAINT)
        write(image, (x, top + high + 16), f"{z:g}", INK, 14)
    z = np.linspace(near, far, 300)
    curves = ((far / (far - near) * (1 - near / z), BLUE), ((z - near) / (far - near), RED))
    for values, color in curves:
        points = [
            (x0 + width * a / 9, top + high * (1 - b)) for a, b in zip(z, values, strict=True)
        ]
        pen.line(points, fill=color, width=3)
    write(image, (x0 + 104, top + 54), "pinhole: (m - n m / z) / (m - n)", BLUE, 15, "lm")
    write(image, (x0 + 236, top + 136), "orthographic: (z - n) / (m - n)", RED, 15, "lm")
    write(image, (x0 + width / 2, 246), "z in camera space, with n = 0.5 and m = 8", INK, 15)
    return image
