// Points in three dimensions without a GPU: each becomes one or two pixels of a picture with depths.

/** A camera that looks at `target` from `distance`; angles in radians. */
export function cameraOf({ azimuth, elevation, distance, target }, width, height) {
  const [ca, sa, ce, se] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(elevation), Math.sin(elevation)];
  const right = [-sa, ca, 0],
    up = [-se * ca, -se * sa, ce],
    back = [ce * ca, ce * sa, se];
  const eye = target.map((t, k) => t + distance * back[k]);
  const focal = 0.9 * Math.min(width, 1.6 * height);
  return { right, up, back, eye, focal, cx: width / 2, cy: height / 2 };
}

/** A place on the screen, with its depth in metres; null behind the camera. */
export function project({ right, up, back, eye, focal, cx, cy }, [x, y, z]) {
  const dx = x - eye[0],
    dy = y - eye[1],
    dz = z - eye[2];
  const depth = -(dx * back[0] + dy * back[1] + dz * back[2]);
  if (depth < 0.05) return null;
  const scale = focal / depth;
  return [
    cx + scale * (dx * right[0] + dy * right[1] + dz * right[2]),
    cy - scale * (dx * up[0] + dy * up[1] + dz * up[2]),
    depth,
  ];
}

/** Draws clouds into a picture that is kept between frames. */
export class Raster {
  resize(context, width, height) {
    if (this.picture?.width === width && this.picture?.height === height) return;
    this.picture = context.createImageData(width, height);
    this.pixels = new Uint32Array(this.picture.data.buffer);
    this.depths = new Float32Array(width * height);
  }

  clear(background) {
    this.pixels.fill(background);
    this.depths.fill(Infinity);
  }

  /** `dark` background or light, on which colours are halved; `points` in the fleet's frame (x, y, z by threes), `colours` as bytes by threes. */
  cloud(
    dark,
    { right: [rx, ry], up: [ux, uy, uz], back: [bx, by, bz], eye: [ex, ey, ez], focal, cx, cy },
    points,
    colours,
  ) {
    const { pixels, depths } = this,
      { width, height } = this.picture;
    for (let k = 0; k < points.length; k += 3) {
      const dx = points[k] - ex,
        dy = points[k + 1] - ey,
        dz = points[k + 2] - ez;
      const depth = -(dx * bx + dy * by + dz * bz);
      if (!(depth > 0.05)) continue;
      const scale = focal / depth;
      const x = (cx + scale * (dx * rx + dy * ry)) | 0,
        y = (cy - scale * (dx * ux + dy * uy + dz * uz)) | 0;
      if (x < 0 || y < 0 || x >= width - 1 || y >= height) continue;
      const at = y * width + x;
      if (depth >= depths[at]) continue;
      depths[at] = depth;
      const tone = (colours[k + 2] << 16) | (colours[k + 1] << 8) | colours[k];
      const paint = 0xff000000 | (dark ? tone : (tone >> 1) & 0x7f7f7f);
      pixels[at] = paint;
      if (scale > 60 && depth < depths[at + 1]) {
        depths[at + 1] = depth;
        pixels[at + 1] = paint;
      }
    }
  }
}
