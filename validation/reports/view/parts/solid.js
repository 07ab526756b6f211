// The surface as a textured height-field: cut where the depth jumps, and where its confidence is low.

const SOLID_VERTEX = `#version 300 es
in vec3 position;
in vec2 place;
uniform mat4 project;
out vec2 at;
void main() { at = place; gl_Position = project * vec4(position, 1); }`;
const SOLID_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D picture;
in vec2 at;
out vec4 colour;
void main() { colour = vec4(texture(picture, at).rgb, 1); }`;
const MOST_VERTICES = 500000;

// Vertices [x, y, z, u, v] in metres and triangles of a map of dioptres; y down, z forward.
function heightField({ dioptres, confidence, least, width, height, intrinsic, distortion, jump }) {
  const stride = Math.max(1, Math.ceil(Math.sqrt(width * height / MOST_VERTICES)));
  const across = Math.ceil(width / stride), down = Math.ceil(height / stride);
  const vertices = new Float32Array(across * down * 5), depths = new Float32Array(across * down);
  const triangles = new Uint32Array(across * down * 6);
  const [[fx, , cx], [, fy, cy]] = intrinsic;
  for (let j = 0, n = 0; j < down; j++) {
    for (let i = 0; i < across; i++, n++) {
      const at = j * stride * width + i * stride, x = i * stride + 0.5 - cx, y = j * stride + 0.5 - cy;
      const trusted = !confidence || confidence[at] >= least;
      const z = depths[n] = trusted && dioptres[at] > 0 ? 1 / dioptres[at] : NaN;
      const r2 = x * x + y * y;
      const factor = distortion.reduceRight((sum, a) => (sum + a) * r2, 0) + 1;
      const u = (i * stride + 0.5) / width, v = (j * stride + 0.5) / height;
      vertices.set([x / fx * factor * z, y / fy * factor * z, z, u, v], n * 5);
    }
  }
  let used = 0;
  const joined = (a, b, c) => {
    const near = Math.min(depths[a], depths[b], depths[c]), far = Math.max(depths[a], depths[b], depths[c]);
    if (far - near <= jump * stride * near) {  // false with a NaN
      triangles.set([a, b, c], used);
      used += 3;
    }
  };
  for (let j = 0; j + 1 < down; j++) {
    for (let i = 0; i + 1 < across; i++) {
      const a = j * across + i, b = a + across;
      joined(a, b, a + 1);
      joined(a + 1, b, b + 1);
    }
  }
  const known = depths.filter((z) => z > 0);  // turned about the mean in dioptres
  const middle = known.length ? known.length / known.reduce((sum, z) => sum + 1 / z, 0) : 1;
  return { vertices, triangles: triangles.subarray(0, used), middle };
}

const multiply = (a, b) => {  // 4 x 4, by columns
  const c = new Float32Array(16);
  for (let i = 0; i < 4; i++) for (let j = 0; j < 4; j++) {
    for (let k = 0; k < 4; k++) c[i * 4 + j] += a[k * 4 + j] * b[i * 4 + k];
  }
  return c;
};

// Projection of a view {turn, tilt, zoom}: with 0, 0, 1 the camera's own perspective.
function projection(view, middle, intrinsic, width, height) {
  const [[fx, , cx], [, fy, cy]] = intrinsic, near = middle / 50, far = middle * 50;
  const perspective = new Float32Array([
    2 * fx / width * view.zoom, 0, 0, 0, 0, -2 * fy / height * view.zoom, 0, 0,
    (2 * cx / width - 1) * view.zoom, (1 - 2 * cy / height) * view.zoom, (far + near) / (far - near), 1,
    0, 0, -2 * far * near / (far - near), 0]);
  const [s, c] = [Math.sin(view.turn), Math.cos(view.turn)], [t, d] = [Math.sin(view.tilt), Math.cos(view.tilt)];
  const move = (z) => new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, z, 1]);
  const turned = new Float32Array([c, 0, -s, 0, 0, 1, 0, 0, s, 0, c, 0, 0, 0, 0, 1]);
  const tilted = new Float32Array([1, 0, 0, 0, 0, d, t, 0, 0, -t, d, 0, 0, 0, 0, 1]);
  return multiply(perspective, multiply(move(middle), multiply(tilted, multiply(turned, move(-middle)))));
}

function solidPainter(gl, painter) {
  const program = compiled(gl, SOLID_VERTEX, SOLID_FRAGMENT), array = gl.createVertexArray();
  const corners = gl.createBuffer(), faces = gl.createBuffer();
  let mesh = null;
  return {
    load(made) {
      mesh = made;
      gl.bindVertexArray(array);
      gl.bindBuffer(gl.ARRAY_BUFFER, corners);
      gl.bufferData(gl.ARRAY_BUFFER, made.vertices, gl.STATIC_DRAW);
      for (const [name, size, offset] of [["position", 3, 0], ["place", 2, 12]]) {
        const at = gl.getAttribLocation(program, name);
        gl.enableVertexAttribArray(at);
        gl.vertexAttribPointer(at, size, gl.FLOAT, false, 20, offset);
      }
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, faces);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, made.triangles, gl.STATIC_DRAW);
      gl.bindVertexArray(null);
    },
    loaded: () => mesh,
    paint(picture, matrix, outside) {
      gl.viewport(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight);
      gl.clearColor(...outside, 1);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      gl.enable(gl.DEPTH_TEST);
      gl.useProgram(program);
      painter.texture(picture, 0, false);
      gl.uniformMatrix4fv(gl.getUniformLocation(program, "project"), false, matrix);
      gl.bindVertexArray(array);
      gl.drawElements(gl.TRIANGLES, mesh.triangles.length, gl.UNSIGNED_INT, 0);
      gl.bindVertexArray(null);
    },
  };
}

