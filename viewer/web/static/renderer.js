// Draws the scene with WebGL 2: what viewer/rendering/renderer.py does, with the same shaders.
//
// A view is { axes: [right, up, back], eye, fov, near }: grid frame, vertical degrees, grid units. Settings are { mode, background:
// sRGB or null for the gradient, surroundings }. Sizes and boxes are in pixels from the lower left corner.
import { cross, dot, norm, radians, scaled, subtract, transform } from "./vectors.js";

const NO_MEMORY = "This device has not enough graphics memory for it.";
const HEADER = "#version 300 es\n";

export class Renderer {
  // scene: a level of it.
  constructor(gl, scene) {
    this.gl = gl;
    this.scene = scene;
    this.programs = new Map();
    this.target = null;
    this.textures = {};
    this.hull = null;
    const most = Math.max(...scene.atlas.size, ...scene.skip_grid.size, ...scene.indirection.size);
    const limit = gl.getParameter(gl.MAX_3D_TEXTURE_SIZE);
    if (most > limit) throw new Error(`It needs 3D textures of ${most} voxels a side; this device takes ${limit}.`);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    this.program(Object.keys(scene.shaders.modes)[0], true); // drivers compile while the worker unpacks
  }

  // Takes the grids, and makes room for the atlas.
  begin({ indirection, skipGrid, hull }) {
    const { gl, scene } = this;
    const blocks = [gl.RGBA_INTEGER, gl.UNSIGNED_BYTE, indirection];
    const words = [gl.RED_INTEGER, gl.UNSIGNED_SHORT, new Uint16Array(skipGrid.buffer)];
    this.textures = {
      indirection: this.texture(gl.RGBA8UI, scene.indirection.size, gl.NEAREST, blocks),
      skip_grid: this.texture(gl.R16UI, scene.skip_grid.size, gl.NEAREST, words),
      atlas_rgba: this.texture(gl.RGBA8, scene.atlas.size, gl.LINEAR),
    };
    this.check();
    if (hull) this.hull = this.corners(hull);
  }

  // Fills a slot of the atlas.
  fill(slot, texels) {
    const { gl } = this;
    const { slots: [nx, ny], block, features } = this.scene.atlas;
    const [width, y, z] = [features ? 2 * block : block, Math.floor(slot / nx) % ny, Math.floor(slot / (nx * ny))];
    const box = [width * (slot % nx), block * y, block * z, width, block, block];
    gl.bindTexture(gl.TEXTURE_3D, this.textures.atlas_rgba);
    gl.texSubImage3D(gl.TEXTURE_3D, 0, ...box, gl.RGBA, gl.UNSIGNED_BYTE, texels);
  }

  check() {
    if (this.gl.getError() !== this.gl.NO_ERROR) throw new Error(NO_MEMORY);
  }

  // Frees what it has on the card.
  release() {
    const { gl } = this;
    this.dropTarget();
    for (const texture of Object.values(this.textures)) gl.deleteTexture(texture);
    for (const { program } of this.programs.values()) gl.deleteProgram(program);
    if (this.hull) {
      gl.deleteVertexArray(this.hull.array);
      gl.deleteBuffer(this.hull.corners);
    }
  }

  dropTarget() {
    if (!this.target) return;
    this.gl.deleteFramebuffer(this.target.framebuffer);
    for (const buffer of this.target.buffers) this.gl.deleteRenderbuffer(buffer);
  }

  // content: what to fill it with: format, type, array.
  texture(format, size, filter, content = null) {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_3D, texture);
    gl.texStorage3D(gl.TEXTURE_3D, 1, format, ...size);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_3D, name, filter);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R])
      gl.texParameteri(gl.TEXTURE_3D, name, gl.CLAMP_TO_EDGE);
    if (content) gl.texSubImage3D(gl.TEXTURE_3D, 0, 0, 0, 0, ...size, ...content);
    return texture;
  }

  corners(bytes) {
    const { gl } = this;
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const corners = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, corners);
    gl.bufferData(gl.ARRAY_BUFFER, bytes, gl.STATIC_DRAW);
    const place = gl.getAttribLocation(this.linked("content_hull.vert", "content_hull.frag").program, "corner");
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 0, 0);
    gl.bindVertexArray(null);
    return { array, corners, count: bytes.byteLength / 12 };
  }

  // Programs

  program(mode, gradient) {
    const { defines, modes, backdrop, overBackground } = this.scene.shaders;
    const behind = gradient && overBackground.includes(mode) ? backdrop : "";
    return this.linked("fullscreen.vert", "snerg.frag", defines + modes[mode] + behind);
  }

  linked(vertex, fragment, defines = "") {
    const key = `${vertex} ${fragment} ${defines}`;
    if (this.programs.has(key)) return this.programs.get(key);
    const { gl } = this;
    const program = gl.createProgram();
    const stages = [[gl.VERTEX_SHADER, vertex, ""], [gl.FRAGMENT_SHADER, fragment, defines]];
    for (const [kind, name, lines] of stages) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, HEADER + lines + this.scene.shaders.texts[name]);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    const made = { program, uniforms: null };
    this.programs.set(key, made);
    return made;
  }

  // Makes a program current and writes its uniforms: [value, ...] by name, matrices column by column.
  use(made, values) {
    const { gl } = this;
    const { program } = made;
    if (!made.uniforms) {
      if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
        const logs = gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader));
        throw new Error(`A shader does not compile: ${[gl.getProgramInfoLog(program), ...logs].join(" ").slice(0, 400)}`);
      }
      made.uniforms = Array.from({ length: gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS) }, (_, i) => {
        const { name, type } = gl.getActiveUniform(program, i);
        return { name, type, place: gl.getUniformLocation(program, name) };
      });
    }
    gl.useProgram(program);
    const setters = {
      [gl.FLOAT]: "uniform1fv", [gl.FLOAT_VEC2]: "uniform2fv", [gl.FLOAT_VEC3]: "uniform3fv", [gl.FLOAT_VEC4]: "uniform4fv",
    };
    let unit = 0;
    for (const { name, type, place } of made.uniforms) {
      if (type === gl.FLOAT_MAT3) gl.uniformMatrix3fv(place, false, values[name]);
      else if (setters[type]) gl[setters[type]](place, values[name]);
      else {
        gl.activeTexture(gl.TEXTURE0 + unit);
        gl.bindTexture(gl.TEXTURE_3D, this.textures[name]);
        gl.uniform1i(place, unit++);
      }
    }
    gl.activeTexture(gl.TEXTURE0);
  }

  // What a view looks like in a picture of width × height.
  uniforms(view, settings, width, height) {
    const { scene } = this;
    const focal = (0.5 * height) / Math.tan(0.5 * radians(view.fov));
    const rows = scene.trainingTGrid;
    const voxels = scene.ndc ? 1 : 1 / scene.voxelSize;
    const position = scaled(subtract(view.eye, scene.minXyz), 1 / scene.voxelSize);
    const [low, high] = settings.surroundings === false ? scene.innerBox : scene.box;
    return {
      ...scene.uniforms,
      ...scene.shaders.look,
      viewport_origin: [0, 0],
      picture_size: [width, height],
      intrinsics: [focal, focal, 0.5 * width, 0.5 * height],
      orthographic: [0],
      grid_R_camera: view.axes.flat(),
      camera_position: position,
      near_plane: [(view.near ?? 0) * voxels],
      ray_near: [0],
      box_min: low,
      box_max: high,
      training_R_camera: view.axes.flatMap((axis) => transform(rows, axis)),
      training_camera: transform(rows, view.eye).map((v, i) => v + rows[i][3]),
      depth_range: this.depthRange(position),
      background: settings.background ?? [1, 1, 1],
      cost_scale: [64],
      backdrop_height: [height],
      backdrop_first: scene.shaders.backdropColours[0],
      backdrop_second: scene.shaders.backdropColours[1],
    };
  }

  depthRange(position) {
    const [low, high] = this.scene.depthBox;
    const size = subtract(high, low);
    if (this.scene.ndc) return [0, norm(size)];
    const away = norm(subtract(scaled(low.map((v, i) => v + high[i]), 0.5), position));
    return [Math.max(away - 0.5 * norm(size), 0), away + 0.5 * norm(size)];
  }

  // Drawing

  // The framebuffer that pictures are drawn into, at least width × height.
  fit(width, height) {
    const { gl } = this;
    if (this.target && this.target.width >= width && this.target.height >= height) return this.target;
    this.dropTarget();
    const framebuffer = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    const formats = [[gl.RGBA8, gl.COLOR_ATTACHMENT0], [gl.DEPTH_COMPONENT16, gl.DEPTH_ATTACHMENT]];
    const buffers = formats.map(([format, attachment]) => {
      const buffer = gl.createRenderbuffer();
      gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
      gl.renderbufferStorage(gl.RENDERBUFFER, format, width, height);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, attachment, gl.RENDERBUFFER, buffer);
      return buffer;
    });
    this.target = { framebuffer, buffers, width, height };
    return this.target;
  }

  // Draws the view, as a picture of width × height, into the framebuffer; of it only `box` [x, y, w, h] where there is one.
  draw(view, settings, width, height, box = [0, 0, width, height]) {
    const { gl, scene } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.fit(width, height).framebuffer);
    gl.viewport(0, 0, width, height);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(...box);
    gl.colorMask(true, true, true, true);
    const values = this.uniforms(view, settings, width, height);
    const gradient = !settings.background;
    const over = scene.shaders.overBackground.includes(settings.mode);
    if (this.hull) {
      const empty = over ? (settings.background ?? [1, 1, 1]) : [0, 0, 0];
      gl.depthMask(true);
      gl.clearColor(...empty, 1);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      if (gradient && over) {
        gl.disable(gl.DEPTH_TEST);
        this.use(this.linked("fullscreen.vert", "backdrop.frag", scene.shaders.backdrop), values);
        gl.drawArrays(gl.TRIANGLES, 0, 3);
      }
      this.markHull(view, values);
    } else gl.disable(gl.DEPTH_TEST);
    this.use(this.program(settings.mode, gradient), values);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.disable(gl.SCISSOR_TEST);
  }

  // Leaves depth 0.5 in the pixels that see the hull of all content; see shaders/content_hull.vert.
  markHull(view, values) {
    const { gl } = this;
    const [right, up, back] = view.axes;
    const turned = dot(cross(right, up), back); // 1, or -1 where the axes are left-handed
    gl.colorMask(false, false, false, false);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    gl.cullFace(gl.FRONT);
    gl.frontFace(turned > 0 ? gl.CCW : gl.CW);
    gl.depthFunc(gl.ALWAYS);
    this.use(this.linked("content_hull.vert", "content_hull.frag"), values);
    gl.bindVertexArray(this.hull.array);
    gl.drawArrays(gl.TRIANGLES, 0, this.hull.count);
    gl.bindVertexArray(null);
    gl.disable(gl.CULL_FACE);
    gl.colorMask(true, true, true, true);
    gl.depthMask(false);
    gl.depthFunc(gl.GREATER);
  }

  // Shows a drawn picture of width × height on the whole canvas.
  show(width, height) {
    const { gl } = this;
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, this.target.framebuffer);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, null);
    const whole = [gl.drawingBufferWidth, gl.drawingBufferHeight];
    const filter = whole[0] === width && whole[1] === height ? gl.NEAREST : gl.LINEAR;
    gl.blitFramebuffer(0, 0, width, height, 0, 0, ...whole, gl.COLOR_BUFFER_BIT, filter);
  }

  // Waits until all is drawn.
  finish() {
    const { gl } = this;
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, this.target.framebuffer);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  }

  // Whether something lies before a point of the grid frame, as a view sees it: by the depth of a pixel that looks there.
  covers(view, settings, point) {
    const ahead = subtract(point, view.eye);
    const distance = norm(ahead) / this.scene.voxelSize;
    const [near, far] = this.depthRange(scaled(subtract(view.eye, this.scene.minXyz), 1 / this.scene.voxelSize));
    if (this.scene.ndc || !(distance > 0 && distance < far)) return false;
    const back = scaled(ahead, -1 / norm(ahead));
    const across = [0, 1].map((i) => cross(view.axes[i], back)).sort((a, b) => norm(b) - norm(a))[0];
    const right = scaled(across, 1 / norm(across));
    const looking = { ...view, axes: [right, cross(back, right), back], fov: 0.1 };
    const [shown] = this.picture(looking, { ...settings, mode: "depth", background: [0, 0, 0] }, 1, 1).data;
    const step = (far - near) / 255;
    return far - shown * step < 0.98 * distance - 3 * step;
  }

  // A view as ImageData of width × height.
  picture(view, settings, width, height) {
    const { gl } = this;
    this.draw(view, settings, width, height);
    const pixels = new Uint8ClampedArray(4 * width * height);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, this.target.framebuffer);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(pixels.buffer));
    const upright = new Uint8ClampedArray(pixels.length);
    for (let y = 0; y < height; y++) upright.set(pixels.subarray(4 * width * y, 4 * width * (y + 1)), 4 * width * (height - 1 - y));
    return new ImageData(upright, width, height);
  }
}
