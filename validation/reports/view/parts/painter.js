// Painting of pictures on the stage: two of them, split at a vertical line, at any magnification.
// A view is {zoom, x, y}: the magnification and the place of the picture, 0..1, in the middle of the stage.

const VERTEX = `#version 300 es
out vec2 at;
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  at = vec2(corner.x, 1.0 - corner.y);
  gl_Position = vec4(corner * 2.0 - 1.0, 0, 1);
}`;
const FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D left, right;
uniform vec3 view;
uniform float split;
uniform vec3 outside;
uniform float coarse, gain;
in vec2 at;
out vec4 colour;
void main() {
  vec2 place = view.yz + (at - 0.5) / view.x;
  vec3 seen = place.x < split ? textureLod(left, place, coarse).rgb : textureLod(right, place, coarse).rgb;
  bool inside = all(greaterThanEqual(place, vec2(0))) && all(lessThanEqual(place, vec2(1)));
  colour = vec4(inside ? seen * gain : outside, 1);
}`;
const MAGNIFIED = 3;  // from here on pixels are shown as squares

function compiled(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new Error(gl.getProgramInfoLog(program));
  }
  return program;
}

function glPainter(gl) {
  const program = compiled(gl, VERTEX, FRAGMENT);
  const at = (name) => gl.getUniformLocation(program, name);
  const places = Object.fromEntries(["view", "split", "outside", "left", "right", "coarse", "gain"].map((n) => [n, at(n)]));
  const textures = new Map();  // by source; the latest few
  gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);

  function texture(source, unit, sharp, coarse = 0) {
    gl.activeTexture(gl.TEXTURE0 + unit);
    let known = textures.get(source);
    if (!known) {
      known = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, known);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, source);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    }
    textures.delete(source);
    textures.set(source, known);
    if (textures.size > 8) {
      const [oldest, unused] = textures.entries().next().value;
      gl.deleteTexture(unused);
      textures.delete(oldest);
    }
    gl.bindTexture(gl.TEXTURE_2D, known);
    if (coarse) gl.generateMipmap(gl.TEXTURE_2D);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, coarse ? gl.LINEAR_MIPMAP_NEAREST : gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, sharp ? gl.NEAREST : gl.LINEAR);
  }

  return {
    texture,
    // Reduced, a mosaic is the mean over its period: period [px] and the share of its pixels that are shown.
    paint({ left, right, split, view, outside, mosaic }) {
      const sharp = view.zoom >= MAGNIFIED, coarse = mosaic && !sharp ? Math.log2(mosaic.period) : 0;
      gl.viewport(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight);
      gl.disable(gl.DEPTH_TEST);
      gl.useProgram(program);
      texture(right, 1, sharp, coarse);
      texture(left, 0, sharp, coarse);
      gl.uniform1f(places.coarse, coarse);
      gl.uniform1f(places.gain, coarse ? 1 / mosaic.share : 1);
      gl.uniform1i(places.left, 0);
      gl.uniform1i(places.right, 1);
      gl.uniform3f(places.view, view.zoom, view.x, view.y);
      gl.uniform1f(places.split, split);
      gl.uniform3f(places.outside, ...outside);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    },
  };
}

// Without WebGL2: the same pictures, no 3D view.
function flatPainter(context) {
  return {
    paint({ left, right, split, view, outside }) {
      const { width, height } = context.canvas;
      context.imageSmoothingEnabled = view.zoom < MAGNIFIED;
      context.fillStyle = `rgb(${outside.map((part) => part * 255).join(" ")})`;
      context.fillRect(0, 0, width, height);
      const x = width * (0.5 - view.x * view.zoom), y = height * (0.5 - view.y * view.zoom);
      const draw = (picture, from, to) => {
        const start = x + from * width * view.zoom, span = (to - from) * width * view.zoom;
        if (!(span > 0)) return;
        context.save();
        context.beginPath();
        context.rect(start, 0, span, height);
        context.clip();
        context.drawImage(picture, x, y, width * view.zoom, height * view.zoom);
        context.restore();
      };
      draw(left, 0, Math.min(Math.max(split, 0), 1));
      draw(right, Math.min(Math.max(split, 0), 1), 1);
    },
  };
}

