"use strict";
// A small WebGL renderer: boxes, cylinders, spheres, ribbons, a floor and shadows straight below things.
// Matrices are column-major arrays of 16; z is up, lengths are in metres.

const Mat = {
  identity: () => [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
  multiply(a, b) {
    const out = new Array(16);
    for (let column = 0; column < 4; column++)
      for (let row = 0; row < 4; row++) {
        let sum = 0;
        for (let k = 0; k < 4; k++) sum += a[4 * k + row] * b[4 * column + k];
        out[4 * column + row] = sum;
      }
    return out;
  },
  place([w, x, y, z], [px, py, pz]) {
    const n = Math.hypot(w, x, y, z) || 1;
    w /= n; x /= n; y /= n; z /= n;
    return [
      1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y), 0,
      2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x), 0,
      2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y), 0,
      px, py, pz, 1,
    ];
  },
  turn([x, y, z], angle) {
    const n = Math.hypot(x, y, z) || 1, s = Math.sin(angle / 2) / n;
    return Mat.place([Math.cos(angle / 2), s * x, s * y, s * z], [0, 0, 0]);
  },
  perspective(view, aspect, near, far) {
    const f = 1 / Math.tan(view / 2);
    return [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, 2 * far * near / (near - far), 0];
  },
  lookAt(eye, target) {
    const unit = (v) => { const n = Math.hypot(...v) || 1; return v.map((c) => c / n); };
    const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    const back = unit([eye[0] - target[0], eye[1] - target[1], eye[2] - target[2]]);
    const right = unit(cross([0, 0, 1], back)), up = cross(back, right);
    return [right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
      -dot(right, eye), -dot(up, eye), -dot(back, eye), 1];
  },
};

const Meshes = {
  box() {
    const out = [];
    for (let axis = 0; axis < 3; axis++)
      for (const side of [-1, 1]) {
        const u = (axis + 1) % 3, v = (axis + 2) % 3, normal = [0, 0, 0];
        normal[axis] = side;
        for (const [a, b] of [[-1, -1], [1, -1], [1, 1], [-1, -1], [1, 1], [-1, 1]]) {
          const point = [0, 0, 0];
          point[axis] = side / 2; point[u] = a / 2; point[v] = b / 2;
          out.push(...point, ...normal);
        }
      }
    return out;
  },
  cylinder(parts = 28) {
    const out = [];
    for (let i = 0; i < parts; i++) {
      const [a, b] = [i, i + 1].map((k) => [Math.cos(2 * Math.PI * k / parts), Math.sin(2 * Math.PI * k / parts)]);
      for (const [c, z] of [[a, -1], [b, -1], [b, 1], [a, -1], [b, 1], [a, 1]]) out.push(c[0] / 2, c[1] / 2, z / 2, c[0], c[1], 0);
      for (const z of [-1, 1]) for (const c of [[0, 0], a, b]) out.push(c[0] / 2, c[1] / 2, z / 2, 0, 0, z);
    }
    return out;
  },
  sphere(rings = 16, parts = 24) {
    const out = [];
    const point = (i, j) => {
      const t = Math.PI * i / rings, p = 2 * Math.PI * j / parts;
      return [Math.sin(t) * Math.cos(p), Math.sin(t) * Math.sin(p), Math.cos(t)];
    };
    for (let i = 0; i < rings; i++)
      for (let j = 0; j < parts; j++)
        for (const [a, b] of [[i, j], [i + 1, j], [i + 1, j + 1], [i, j], [i + 1, j + 1], [i, j + 1]]) {
          const n = point(a, b);
          out.push(n[0] / 2, n[1] / 2, n[2] / 2, ...n);
        }
    return out;
  },
};

const SOLID_VERTEX = `#version 300 es
in vec3 position; in vec3 normal;
uniform mat4 camera, model; uniform vec3 size; uniform float plane; uniform bool flatten_;
out vec3 worldNormal, world;
void main() {
  vec4 at = model * vec4(position * size, 1.0);
  if (flatten_) at.z = plane;
  world = at.xyz;
  worldNormal = mat3(model) * (normal / size);
  gl_Position = camera * at;
}`;
const SOLID_FRAGMENT = `#version 300 es
precision highp float;
in vec3 worldNormal, world;
uniform vec4 color, clip; uniform bool flatten_; uniform vec3 eye;
out vec4 pixel;
void main() {
  if (flatten_) {
    if (world.x < clip.x || world.y < clip.y || world.x > clip.z || world.y > clip.w) discard;
    pixel = color; return;
  }
  vec3 n = normalize(worldNormal), toEye = normalize(eye - world);
  vec3 key = normalize(vec3(-0.35, -0.55, 0.9));
  float light = 0.50 + 0.16 * n.z + 0.46 * max(dot(n, key), 0.0) + 0.10 * max(dot(n, normalize(vec3(0.8, 0.5, 0.1))), 0.0);
  float shine = pow(max(dot(n, normalize(key + toEye)), 0.0), 40.0);
  pixel = vec4(color.rgb * light + 0.12 * shine, color.a);
}`;
const RIBBON_VERTEX = `#version 300 es
in vec2 corner; in vec3 from; in vec3 to;
uniform mat4 camera; uniform vec2 pixels; uniform float width;
void main() {
  vec4 a = camera * vec4(from, 1.0), b = camera * vec4(to, 1.0);
  if (a.w < 0.05 || b.w < 0.05) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
  vec2 along = (b.xy / b.w - a.xy / a.w) * pixels;
  float reach = length(along);
  along = reach > 1e-5 ? along / reach : vec2(1.0, 0.0);
  vec4 at = corner.x > 0.5 ? b : a;
  // Half a width longer on both ends, so that pieces join without gaps.
  vec2 offset = vec2(-along.y, along.x) * corner.y + along * (corner.x > 0.5 ? 0.5 : -0.5);
  gl_Position = vec4(at.xy + offset * width / pixels * at.w, at.z - 0.0005 * at.w, at.w);
}`;
const FLAT_FRAGMENT = `#version 300 es
precision highp float;
uniform vec4 color; out vec4 pixel;
void main() { pixel = color; }`;
const FLOOR_VERTEX = `#version 300 es
in vec3 position; uniform mat4 camera; out vec2 at;
void main() { at = position.xy; gl_Position = camera * vec4(position, 1.0); }`;
const FLOOR_FRAGMENT = `#version 300 es
precision highp float;
in vec2 at; uniform vec3 ground, grid, sky; out vec4 pixel;
float line(float spacing, float width) {
  vec2 cell = abs(fract(at / spacing - 0.5) - 0.5) * spacing / fwidth(at);
  return 1.0 - min(min(cell.x, cell.y) / width, 1.0);
}
void main() {
  float far = smoothstep(2.0, 7.5, length(at - vec2(1.2, 0.0)));
  vec3 floor_ = mix(ground, grid, max(0.55 * line(0.25, 1.0), line(1.0, 1.4)));
  pixel = vec4(mix(floor_, sky, far), 1.0);
}`;

class Scene {
  constructor(canvas) {
    this.canvas = canvas;
    const gl = (this.gl = canvas.getContext("webgl2", { antialias: true, stencil: true, alpha: false, preserveDrawingBuffer: true }));
    if (!gl) throw new Error("no WebGL 2");
    this.solid = this.program(SOLID_VERTEX, SOLID_FRAGMENT);
    this.ribbon = this.program(RIBBON_VERTEX, FLAT_FRAGMENT);
    this.floor = this.program(FLOOR_VERTEX, FLOOR_FRAGMENT);
    this.meshes = {};
    for (const kind of Object.keys(Meshes)) {
      const data = Meshes[kind]();
      this.meshes[kind] = { buffer: this.buffer(data), count: data.length / 6 };
    }
    this.floorBuffer = this.buffer([-9, -9, 0, 11, -9, 0, 11, 9, 0, -9, -9, 0, 11, 9, 0, -9, 9, 0]);
    this.corners = this.buffer([0, -0.5, 1, -0.5, 1, 0.5, 0, -0.5, 1, 0.5, 0, 0.5]);
    this.segments = gl.createBuffer();
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  }

  program(vertex, fragment) {
    const gl = this.gl, program = gl.createProgram();
    for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    const places = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(program, i);
      places[name] = gl.getUniformLocation(program, name);
    }
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_ATTRIBUTES); i++) {
      const { name } = gl.getActiveAttrib(program, i);
      places[name] = gl.getAttribLocation(program, name);
    }
    return { program, ...places };
  }

  buffer(data) {
    const gl = this.gl, buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(data), gl.STATIC_DRAW);
    return buffer;
  }

  attribute(place, size, stride, offset, divisor = 0) {
    const gl = this.gl;
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, gl.FLOAT, false, 4 * stride, 4 * offset);
    gl.vertexAttribDivisor(place, divisor);
  }

  // Draws: camera {eye, target, view}, colours of the theme, and lists of solids {kind, size, model, color, alpha, layer} and
  // ribbons {points: [[from, to], ...] flat, color, alpha, width}. Solids of layer 0 are opaque, further layers are
  // transparent as a whole, one after the other.
  draw({ camera, theme, solids, ribbons, boxes }) {
    const gl = this.gl, canvas = this.canvas;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.max(1, Math.round(canvas.clientWidth * ratio)), height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    gl.viewport(0, 0, width, height);
    gl.clearColor(...theme.sky, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    this.eye = camera.eye;
    this.matrix = Mat.multiply(Mat.perspective(camera.view, width / height, 0.05, 40), Mat.lookAt(camera.eye, camera.target));
    this.pixels = [width / 2, height / 2];
    this.ratio = ratio;
    for (let i = 0; i < 8; i++) { gl.disableVertexAttribArray(i); gl.vertexAttribDivisor(i, 0); }

    gl.useProgram(this.floor.program);
    gl.uniformMatrix4fv(this.floor.camera, false, this.matrix);
    gl.uniform3fv(this.floor.ground, theme.ground);
    gl.uniform3fv(this.floor.grid, theme.grid);
    gl.uniform3fv(this.floor.sky, theme.sky);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.floorBuffer);
    this.attribute(this.floor.position, 3, 3, 0);
    gl.depthMask(false);
    gl.drawArrays(gl.TRIANGLES, 0, 6);
    gl.depthMask(true);

    gl.useProgram(this.solid.program);
    gl.uniformMatrix4fv(this.solid.camera, false, this.matrix);
    gl.uniform3fv(this.solid.eye, this.eye);
    const fixed = boxes.map((box) => ({ kind: "box", size: box.size, model: Mat.place([1, 0, 0, 0], box.at), color: theme.box, alpha: 1 }));
    this.shadows(fixed.concat(solids), 0.001, [-99, -99, 99, 99], theme.shadow);
    this.solids(fixed);
    for (const box of boxes) {
      const [x, y, z] = box.at, [a, b, c] = box.size;
      this.shadows(solids, z + c / 2 + 0.001, [x - a / 2, y - b / 2, x + a / 2, y + b / 2], theme.shadow);
    }
    const layers = [...new Set(solids.map((solid) => solid.layer))].sort((a, b) => a - b);
    for (const layer of layers) {
      const own = solids.filter((solid) => solid.layer === layer);
      if (layer > 0) {
        // A little behind, so that where two robots are in the same place the one in front is seen.
        gl.enable(gl.POLYGON_OFFSET_FILL);
        gl.polygonOffset(2 * layer, 24 * layer);
        // Depth first, so that of a transparent robot only the nearest surface is seen.
        gl.colorMask(false, false, false, false);
        this.solids(own);
        gl.colorMask(true, true, true, true);
        gl.enable(gl.BLEND);
      }
      this.solids(own);
      gl.disable(gl.BLEND);
      gl.disable(gl.POLYGON_OFFSET_FILL);
    }
    this.lines(ribbons);
  }

  solids(list) {
    for (const solid of list) this.one(solid, [...solid.color, solid.alpha]);
  }

  one({ kind, size, model }, color) {
    const gl = this.gl, mesh = this.meshes[kind];
    gl.bindBuffer(gl.ARRAY_BUFFER, mesh.buffer);
    this.attribute(this.solid.position, 3, 6, 0);
    this.attribute(this.solid.normal, 3, 6, 3);
    gl.uniformMatrix4fv(this.solid.model, false, model);
    gl.uniform3fv(this.solid.size, size.map((side) => Math.max(side, 1e-4)));
    gl.uniform4fv(this.solid.color, color);
    gl.drawArrays(gl.TRIANGLES, 0, mesh.count);
  }

  shadows(list, plane, clip, strength) {
    const gl = this.gl;
    gl.enable(gl.BLEND);
    gl.enable(gl.STENCIL_TEST);
    gl.clear(gl.STENCIL_BUFFER_BIT);
    gl.stencilFunc(gl.EQUAL, 0, 255);
    gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
    gl.depthMask(false);
    gl.uniform1i(this.solid.flatten_, 1);
    gl.uniform1f(this.solid.plane, plane);
    gl.uniform4fv(this.solid.clip, clip);
    for (const solid of list) if (!solid.bright && solid.model[14] > plane) this.one(solid, [0, 0, 0, strength * (solid.layer ? 0.5 : 1)]);
    gl.uniform1i(this.solid.flatten_, 0);
    gl.depthMask(true);
    gl.disable(gl.STENCIL_TEST);
    gl.disable(gl.BLEND);
  }

  lines(ribbons) {
    const gl = this.gl, place = this.ribbon;
    gl.useProgram(place.program);
    gl.uniformMatrix4fv(place.camera, false, this.matrix);
    gl.uniform2fv(place.pixels, this.pixels);
    gl.enable(gl.BLEND);
    gl.depthMask(false);
    for (let i = 0; i < 8; i++) gl.disableVertexAttribArray(i);
    for (const { points, color, alpha, width } of ribbons) {
      if (points.length < 6) continue;
      gl.bindBuffer(gl.ARRAY_BUFFER, this.corners);
      this.attribute(place.corner, 2, 2, 0);
      gl.bindBuffer(gl.ARRAY_BUFFER, this.segments);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(points), gl.DYNAMIC_DRAW);
      this.attribute(place.from, 3, 6, 0, 1);
      this.attribute(place.to, 3, 6, 3, 1);
      gl.uniform4fv(place.color, [...color, alpha]);
      gl.uniform1f(place.width, width * this.ratio);
      gl.drawArraysInstanced(gl.TRIANGLES, 0, 6, points.length / 6);
    }
    gl.depthMask(true);
    gl.disable(gl.BLEND);
    for (let i = 0; i < 8; i++) { gl.disableVertexAttribArray(i); gl.vertexAttribDivisor(i, 0); }
  }
}
