// The bent sheets in WebGL 2: the map as their colour, a floor with a grid and their shadows below them.

const SHEET = {
  vertex: `#version 300 es
    in vec3 place; in vec3 normal; in vec2 where; in float side;
    uniform mat4 camera; uniform float floorZ; uniform bool shadow;
    out vec3 facing; out vec2 on; flat out float part;
    void main() {
      facing = normal; on = where; part = side;
      gl_Position = camera * vec4(shadow ? vec3(place.xy, floorZ) : place, 1.0);
    }`,
  fragment: `#version 300 es
    precision highp float;
    in vec3 facing; in vec2 on; flat in float part;
    uniform sampler2D map; uniform sampler2D colours; uniform vec3 light; uniform vec2 size;
    uniform vec3 gel; uniform bool shadow; uniform bool disc; uniform float shade; uniform bool silent;
    out vec4 colour;
    void main() {
      if (disc && length(on - 0.5) > 0.5) discard;
      if (shadow) { colour = vec4(0.0, 0.0, 0.0, shade); return; }
      float lit = dot(normalize(facing), light);
      float bright = 0.74 + 0.26 * lit;
      vec3 base = gel;
      if (part < 0.5 && !silent) {
        base = texture(colours, vec2(texture(map, on).r * 255.0 / 256.0 + 0.5 / 256.0, 0.5)).rgb;
        vec2 cell = on * size / 10.0, width = fwidth(cell);
        vec2 near = abs(fract(cell - 0.5) - 0.5) / max(width, vec2(1e-6));
        float line = (1.0 - min(min(near.x, near.y), 1.0)) * clamp(0.35 / max(width.x, width.y), 0.0, 1.0);
        base = mix(base, vec3(1.0), 0.10 * line);
      }
      colour = vec4(base * bright + 0.06 * pow(max(lit, 0.0), 24.0), 1.0);
    }`,
};
const FLOOR = {
  vertex: `#version 300 es
    in vec3 place; uniform mat4 camera; uniform vec3 middle; out vec3 at;
    void main() { at = place - middle; gl_Position = camera * vec4(place, 1.0); }`,
  fragment: `#version 300 es
    precision highp float;
    in vec3 at; uniform vec4 ink; uniform float reach; out vec4 colour;
    void main() { colour = vec4(ink.rgb, ink.a * smoothstep(reach, 0.35 * reach, length(at.xy))); }`,
};
const STRIDE = 36;

export class Scene {
  constructor(canvas) {
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: true, premultipliedAlpha: true, stencil: true });
    this.gl = gl;
    this.canvas = canvas;
    if (!gl) return;
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      this.build();
      this.setColours(this.palette);
    });
    this.build();
  }

  build() {
    const { gl } = this;
    this.sheet = program(gl, SHEET);
    this.floor = program(gl, FLOOR);
    this.meshes = [];
    this.lines = gl.createBuffer();
    this.colours = texture(gl, gl.LINEAR);
    gl.enable(gl.DEPTH_TEST);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  }

  setColours(palette) {
    this.palette = palette;
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, this.colours);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, palette);
  }

  /** The buffers and the map's texture of one sheet, with what is drawn now in them. */
  meshOf(k, { surface, map, shape }) {
    const { gl } = this;
    const mesh = this.meshes[k] ??= {
      vertices: gl.createBuffer(), triangles: gl.createBuffer(), map: texture(gl, gl.LINEAR), surface: null, count: 0,
    };
    if (mesh.surface !== surface) {
      const { vertices, triangles } = surface.mesh();
      gl.bindBuffer(gl.ARRAY_BUFFER, mesh.vertices);
      gl.bufferData(gl.ARRAY_BUFFER, vertices, gl.DYNAMIC_DRAW);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.triangles);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, triangles, gl.DYNAMIC_DRAW);
      Object.assign(mesh, { surface, count: triangles.length });
    }
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, mesh.map);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8, shape[1], shape[0], 0, gl.RED, gl.UNSIGNED_BYTE, map);
    return mesh;
  }

  /** Draw sheets, each {surface, map, shape, disc, silent}, within a box; dark says which ground is behind them. */
  draw(camera, box, items, dark) {
    const { gl, canvas } = this;
    camera.look(box);
    const matrix = camera.matrix(canvas.width / canvas.height);
    if (!gl || gl.isContextLost() || !this.palette) return matrix;
    const floorZ = box.low[2] - Math.max(6, 0.06 * box.radius);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    this.drawFloor(camera, matrix, box, floorZ, dark);

    gl.useProgram(this.sheet.program);
    const at = this.sheet.at;
    gl.uniformMatrix4fv(at.camera, false, matrix);
    gl.uniform1f(at.floorZ, floorZ);
    gl.uniform3fv(at.light, camera.light);
    gl.uniform3fv(at.gel, dark ? [0.36, 0.4, 0.47] : [0.72, 0.75, 0.8]);
    gl.uniform1f(at.shade, dark ? 0.45 : 0.13);
    gl.uniform1i(at.map, 0);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.colours);
    gl.uniform1i(at.colours, 1);
    const meshes = items.map((item, k) => this.meshOf(k, item));

    gl.enable(gl.BLEND);
    gl.enable(gl.STENCIL_TEST); // each pixel of the shadows is darkened once
    gl.stencilFunc(gl.EQUAL, 0, 255);
    gl.stencilOp(gl.KEEP, gl.INCR, gl.INCR);
    gl.disable(gl.DEPTH_TEST);
    gl.uniform1i(at.shadow, 1);
    if (camera.eye[2] > floorZ) items.forEach((item, k) => this.drawSheet(meshes[k], item));
    gl.disable(gl.STENCIL_TEST);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.uniform1i(at.shadow, 0);
    items.forEach((item, k) => this.drawSheet(meshes[k], item));
    return matrix;
  }

  drawSheet(mesh, { surface, disc, silent }) {
    const { gl, sheet } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, mesh.vertices);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.triangles);
    attribute(gl, sheet, "place", 3, STRIDE, 0);
    attribute(gl, sheet, "normal", 3, STRIDE, 12);
    attribute(gl, sheet, "where", 2, STRIDE, 24);
    attribute(gl, sheet, "side", 1, STRIDE, 32);
    gl.uniform2fv(sheet.at.size, surface.sizeMm);
    gl.uniform1i(sheet.at.disc, disc ? 1 : 0);
    gl.uniform1i(sheet.at.silent, silent ? 1 : 0);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, mesh.map);
    gl.drawElements(gl.TRIANGLES, mesh.count, gl.UNSIGNED_SHORT, 0);
  }

  drawFloor(camera, matrix, { centre, radius }, z, dark) {
    const reach = 3.2 * radius, step = [50, 100, 200, 500, 1000].find((mm) => reach / mm < 16) ?? reach / 16;
    const { gl } = this, points = [], [mx, my] = centre, n = Math.ceil(reach / step);
    for (let k = -n; k <= n; k++) {
      const x = (Math.round(mx / step) + k) * step, y = (Math.round(my / step) + k) * step;
      for (let j = -n; j < n; j++) { // in pieces, so that they can fade
        const x0 = (Math.round(mx / step) + j) * step, y0 = (Math.round(my / step) + j) * step;
        points.push(x, y0, z, x, y0 + step, z, x0, y, z, x0 + step, y, z);
      }
    }
    gl.useProgram(this.floor.program);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.lines);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(points), gl.DYNAMIC_DRAW);
    attribute(gl, this.floor, "place", 3, 12, 0);
    gl.uniformMatrix4fv(this.floor.at.camera, false, matrix);
    gl.uniform3f(this.floor.at.middle, mx, my, z);
    gl.uniform1f(this.floor.at.reach, reach);
    gl.uniform4fv(this.floor.at.ink, dark ? [0.75, 0.8, 0.9, 0.22] : [0.2, 0.27, 0.4, 0.3]);
    gl.enable(gl.BLEND);
    gl.depthMask(false);
    gl.drawArrays(gl.LINES, 0, points.length / 3);
    gl.depthMask(true);
  }
}

function program(gl, { vertex, fragment }) {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    const failed = !gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost();
    if (failed) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  const at = {}, count = gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS) || 0;
  for (let i = 0; i < count; i++) {
    const { name } = gl.getActiveUniform(made, i);
    at[name] = gl.getUniformLocation(made, name);
  }
  return { program: made, at };
}

function attribute(gl, { program: of }, name, size, stride, offset) {
  const at = gl.getAttribLocation(of, name);
  if (at < 0) return;
  gl.enableVertexAttribArray(at);
  gl.vertexAttribPointer(at, size, gl.FLOAT, false, stride, offset);
}

function texture(gl, filter) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, filter);
  for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
  return made;
}
