// A surface as triangles: from the places of pixels' centres to the corners between them, two sides and a border.

export class Surface {
  constructor(revision, cloud, rows, columns, sizeMm, thicknessMm) {
    Object.assign(this, { revision, rows, columns, sizeMm, thicknessMm });
    this.across = columns + 1;
    this.corners = corners(cloud, rows, columns);
    this.normals = normals(this.corners, rows + 1, columns + 1);
    this.box();
  }

  box() {
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (let i = 0; i < this.corners.length; i++) {
      low[i % 3] = Math.min(low[i % 3], this.corners[i]);
      high[i % 3] = Math.max(high[i % 3], this.corners[i]);
    }
    this.low = low;
    this.high = high;
    this.centre = low.map((value, axis) => (value + high[axis]) / 2);
    this.radius = Math.hypot(...low.map((value, axis) => high[axis] - value)) / 2;
  }

  /** Place and normal under (x, y) of the flat sheet. */
  at(x, y) {
    const u = Math.min(Math.max((x / this.sizeMm[0]) * this.columns, 0), this.columns);
    const v = Math.min(Math.max((y / this.sizeMm[1]) * this.rows, 0), this.rows);
    const c = Math.min(Math.floor(u), this.columns - 1), r = Math.min(Math.floor(v), this.rows - 1);
    const mix = (values) => {
      const out = [0, 0, 0];
      for (const [dr, dc] of [[0, 0], [0, 1], [1, 0], [1, 1]]) {
        const weight = (dr ? v - r : 1 - v + r) * (dc ? u - c : 1 - u + c);
        const i = 3 * ((r + dr) * this.across + c + dc);
        for (let k = 0; k < 3; k++) out[k] += weight * values[i + k];
      }
      return out;
    };
    const normal = mix(this.normals), size = Math.hypot(...normal) || 1;
    return { place: mix(this.corners), normal: normal.map((value) => value / size) };
  }

  /** Vertices (x y z, nx ny nz, u v, side) and triangles; side is 0 above, 1 below, 2 on the border. */
  mesh() {
    if (this.made) return this.made;
    const { rows, columns, across } = this, n = (rows + 1) * across;
    const vertices = [], triangles = [];
    const put = (i, side, normal) => {
      const below = side === 1 || side === 3, u = (i % across) / columns, v = Math.floor(i / across) / rows;
      const deep = below ? this.thicknessMm : 0;
      for (let k = 0; k < 3; k++) vertices.push(this.corners[3 * i + k] - deep * this.normals[3 * i + k]);
      vertices.push(...normal, u, v, side === 3 ? 2 : side);
      return vertices.length / 9 - 1;
    };
    const normalOf = (i, sign) => [0, 1, 2].map((k) => sign * this.normals[3 * i + k]);
    for (let i = 0; i < n; i++) put(i, 0, normalOf(i, 1));
    for (let i = 0; i < n; i++) put(i, 1, normalOf(i, -1));
    for (let r = 0; r < rows; r++) {
      for (let c = 0; c < columns; c++) {
        const i = r * across + c;
        triangles.push(i, i + 1, i + across + 1, i, i + across + 1, i + across);
        triangles.push(n + i, n + i + across + 1, n + i + 1, n + i, n + i + across, n + i + across + 1);
      }
    }
    const round = [];
    for (let c = 0; c < columns; c++) round.push(c);
    for (let r = 0; r < rows; r++) round.push(r * across + columns);
    for (let c = columns; c > 0; c--) round.push(rows * across + c);
    for (let r = rows; r > 0; r--) round.push(r * across);
    round.forEach((i, k) => {
      const j = round[(k + 1) % round.length];
      const along = [0, 1, 2].map((a) => this.corners[3 * j + a] - this.corners[3 * i + a]);
      const up = normalOf(i, 1), out = unit(cross(along, up));
      const [a, b, c, d] = [put(i, 2, out), put(j, 2, out), put(j, 3, out), put(i, 3, out)];
      triangles.push(a, d, c, a, c, b);
    });
    this.made = { vertices: new Float32Array(vertices), triangles: new Uint16Array(triangles) };
    return this.made;
  }
}

export function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

export function unit(a) {
  const size = Math.hypot(...a) || 1;
  return a.map((value) => value / size);
}

function corners(cloud, rows, columns) {
  const n = rows * columns, out = new Float32Array(3 * (rows + 1) * (columns + 1));
  const centre = (axis, r, c) => { // beyond the outermost centres it is extended straight
    const ri = Math.min(Math.max(r, 0), rows - 1), ci = Math.min(Math.max(c, 0), columns - 1);
    const at = (row, column) => cloud[axis * n + row * columns + column];
    let value = at(ri, ci);
    if (r !== ri) value += at(ri, ci) - at(ri + (r < 0 ? 1 : -1), ci);
    if (c !== ci) value += at(ri, ci) - at(ri, ci + (c < 0 ? 1 : -1));
    return value;
  };
  let i = 0;
  for (let r = 0; r <= rows; r++) {
    for (let c = 0; c <= columns; c++) {
      for (let axis = 0; axis < 3; axis++) {
        const four = centre(axis, r - 1, c - 1) + centre(axis, r - 1, c) + centre(axis, r, c - 1) + centre(axis, r, c);
        out[i++] = four / 4;
      }
    }
  }
  return out;
}

function normals(points, rows, across) {
  const out = new Float32Array(points.length);
  const at = (r, c) => {
    const i = 3 * (Math.min(Math.max(r, 0), rows - 1) * across + Math.min(Math.max(c, 0), across - 1));
    return [points[i], points[i + 1], points[i + 2]];
  };
  const minus = (a, b) => a.map((value, k) => value - b[k]);
  for (let r = 0; r < rows; r++) {
    for (let c = 0; c < across; c++) {
      const normal = unit(cross(minus(at(r, c + 1), at(r, c - 1)), minus(at(r + 1, c), at(r - 1, c))));
      out.set(normal, 3 * (r * across + c));
    }
  }
  return out;
}
