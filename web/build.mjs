// Bundles the page into web/dist, which is committed and travels inside the binary. `node build.mjs --check`
// builds aside and fails when the committed files differ.
import { build } from "esbuild";
import { cp, mkdtemp, mkdir, readFile, rm } from "node:fs/promises";
import { gzipSync } from "node:zlib";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const check = process.argv.includes("--check");
const out = check ? await mkdtemp(join(tmpdir(), "page-")) : join(here, "dist");
const limit = 120_000;

await mkdir(out, { recursive: true });
await build({
  entryPoints: [join(here, "src/app.ts"), join(here, "src/app.css")],
  bundle: true,
  minify: true,
  format: "esm",
  target: ["chrome110", "firefox110", "safari16"],
  outdir: out,
  legalComments: "eof",
  logLevel: "warning",
});
for (const file of ["index.html", "icon.svg"]) await cp(join(here, "src", file), join(out, file));

let total = 0;
for (const file of ["index.html", "app.js", "app.css", "icon.svg"]) {
  const text = await readFile(join(out, file));
  const packed = gzipSync(text, { level: 9 }).length;
  total += packed;
  console.log(`${file.padEnd(12)} ${String(text.length).padStart(7)} B, ${packed} B compressed`);
  if (check && !text.equals(await readFile(join(here, "dist", file)))) {
    console.error(`${file}: the committed file is not what its sources give; run \`npm run build\``);
    process.exitCode = 1;
  }
}
console.log(`page         ${total} B compressed of ${limit} B`);
if (total > limit) {
  console.error("the page is too large");
  process.exitCode = 1;
}
if (check) await rm(out, { recursive: true });
