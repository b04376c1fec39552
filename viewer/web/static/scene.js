// The scene of a page: its description, and the data of its levels, from the page itself or from files beside it.

const FROM_DISK =
  "Browsers do not let a page in a folder read the files beside it. Put the folder on a web server; or run python3 -m http.server in it, and open localhost:8000.";

// A description, see viewer/web/description.py, of a page: this one, or a newer one.
export function sceneOf(scene, page = document) {
  for (const level of scene.levels) level.shaders = { ...scene.shaders, defines: level.defines };
  scene.inside = [...page.querySelectorAll("script.data")];
  scene.worker = new Worker(URL.createObjectURL(new Blob([scene.worker], { type: "text/javascript" })));
  return scene;
}

const FIRST_CHARACTER = 0x5000;

// The bytes of a text whose characters hold 15 bits each: viewer/web/page.py.
function bytesOf(text) {
  const bytes = new Uint8Array((15 * text.length) / 8);
  let [bits, known, at] = [0, 0, 0];
  for (let i = 0; i < text.length; i++) {
    bits = (bits << 15) | (text.charCodeAt(i) - FIRST_CHARACTER);
    for (known += 15; known >= 8; known -= 8) bytes[at++] = bits >> (known - 8);
  }
  return bytes;
}

// The data of a level. onProgress: called with the share that has arrived.
async function dataOf(scene, index, onProgress) {
  const inside = scene.inside[index];
  if (inside) {
    const data = new Blob([bytesOf(inside.textContent)]); // outside of the page's memory
    inside.textContent = "";
    return data;
  }
  if (location.protocol === "file:") throw new Error(FROM_DISK);
  const level = scene.levels[index];
  const answer = await fetch(level.file);
  if (!answer.ok) throw new Error(`${level.file}: the server answers ${answer.status}.`);
  let arrived = 0;
  const counted = new TransformStream({
    transform(piece, controller) {
      arrived += piece.length;
      onProgress(arrived / level.bytes);
      controller.enqueue(piece);
    },
  });
  const data = await new Response(answer.body.pipeThrough(counted)).blob();
  if (data.size !== level.bytes) throw new Error(`${level.file} is not complete.`);
  return data;
}

// Unpacks a level into the textures of a renderer. onProgress: called with the share that is done.
export async function unpack(scene, index, renderer, onProgress) {
  const begun = index in scene.inside ? 0 : 0.5;
  const data = await dataOf(scene, index, (share) => onProgress(begun * share));
  const { worker } = scene;
  return new Promise((resolve, reject) => {
    worker.onerror = (event) => reject(new Error(event.message || "the scene could not be unpacked"));
    worker.onmessage = ({ data: { grids, slot, texels, progress, error } }) => {
      if (error) return reject(new Error(error));
      if (progress !== undefined) return onProgress(begun + (1 - begun) * progress);
      try {
        if (grids) renderer.begin(grids);
        else if (texels) {
          renderer.fill(slot, texels);
          worker.postMessage(texels, [texels.buffer]);
        } else resolve(null);
      } catch (problem) {
        reject(problem);
      }
    };
    worker.postMessage({ data, level: scene.levels[index] });
  });
}
