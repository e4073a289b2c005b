// node scalars.mjs BAG.mcap: every scalar of every topic of a ros2 bag, how many and how often, by
// Foxglove's own libraries: npm install @mcap/core @mcap/nodejs @mcap/support @foxglove/rosmsg
// @foxglove/rosmsg2-serialization
import { McapIndexedReader } from "@mcap/core";
import { loadDecompressHandlers } from "@mcap/support";
import { FileHandleReadable } from "@mcap/nodejs";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { open } from "node:fs/promises";

const file = await open(process.argv[2]);
const bag = await McapIndexedReader.Initialize({
  readable: new FileHandleReadable(file),
  decompressHandlers: await loadDecompressHandlers(),
});
const readers = new Map();
const series = new Map();

function add(name, value, at) {
  if (typeof value === "number" || typeof value === "bigint") {
    const one = series.get(name) ?? { count: 0, begin: at, first: value };
    series.set(name, { ...one, count: one.count + 1, end: at, last: value });
  } else if (value && typeof value === "object" && !(value instanceof Uint8Array)) {
    for (const [key, part] of Object.entries(value)) add(`${name}.${key}`, part, at);
  }
}

for await (const { channelId, data, logTime } of bag.readMessages()) {
  const channel = bag.channelsById.get(channelId);
  if (channel.messageEncoding !== "cdr") continue;
  if (!readers.has(channelId)) {
    const schema = bag.schemasById.get(channel.schemaId);
    readers.set(channelId, new MessageReader(parse(new TextDecoder().decode(schema.data), { ros2: true })));
  }
  add(channel.topic, readers.get(channelId).readMessage(data), Number(logTime) / 1e9);
}
for (const [name, { count, begin, end, first, last }] of series) {
  const rate = end > begin ? (count - 1) / (end - begin) : 0;
  console.log(`${name}\t${count}\t${rate.toFixed(1)}/s\t${first}\t${last}`);
}
await file.close();
