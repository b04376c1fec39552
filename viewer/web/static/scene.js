// The scene of a page: its description, and the data of its levels, from the page itself or from files beside it.

const FROM_DISK =
  "Browsers do not let a page in a folder read the files beside it. Put the folder on a web server; or run python3 -m http.server in it, and open localhost:8000.";

// A description, see viewer/web/description.py, of a page: this one, or a newer one.
export function sceneOf(scene, page = document) {
  for (const level of scene.levels) level.shaders = { ...scene.shaders, common: level.defines + scene.shaders.common };
  scene.inside = [...page.querySelectorAll("script.data")];
  return scene;
}

// The bytes of a level, or their base64. onProgress: called with the share that has arrived.
async function dataOf(scene, index, onProgress) {
  const inside = scene.inside[index];
  if (inside) {
    const text = inside.textContent.trim();
    inside.textContent = ""; // as large as the scene
    return text;
  }
  if (location.protocol === "file:") throw new Error(FROM_DISK);
  const level = scene.levels[index];
  const answer = await fetch(level.file);
  if (!answer.ok) throw new Error(`${level.file}: the server answers ${answer.status}.`);
  const bytes = new Uint8Array(level.bytes);
  const reader = answer.body.getReader();
  for (let at = 0; ; ) {
    const { done, value } = await reader.read();
    if (done && at === bytes.length) return bytes;
    if (done || at + value.length > bytes.length) throw new Error(`${level.file} is not complete.`);
    bytes.set(value, at);
    at += value.length;
    onProgress(at / bytes.length);
  }
}

// The textures' bytes of a level; see decode.js. onProgress: called with the share that is done.
export async function unpack(scene, index, onProgress) {
  const data = await dataOf(scene, index, (share) => onProgress(0.5 * share));
  const begun = typeof data === "string" ? 0 : 0.5;
  const worker = new Worker(URL.createObjectURL(new Blob([scene.worker], { type: "text/javascript" })));
  return new Promise((resolve, reject) => {
    worker.onerror = (event) => reject(new Error(event.message || "the scene could not be unpacked"));
    worker.onmessage = ({ data: answer }) => {
      if (answer.progress !== undefined) return onProgress(begun + (1 - begun) * answer.progress);
      worker.terminate();
      if (answer.error) reject(new Error(answer.error));
      else resolve(answer);
    };
    worker.postMessage({ data, level: scene.levels[index] }, typeof data === "string" ? [] : [data.buffer]);
  });
}
