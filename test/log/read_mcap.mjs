// SPDX-License-Identifier: Apache-2.0
// Print each message of an MCAP file as a line of JSON, by the index of the file, decoded by the
// definitions in it:  node read_mcap.mjs FILE.mcap

import { parse } from '@foxglove/rosmsg';
import { MessageReader } from '@foxglove/rosmsg2-serialization';
import { McapIndexedReader } from '@mcap/core';
import { decompress } from 'fzstd';
import { open } from 'node:fs/promises';

const file = await open(process.argv[2]);
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, size) => {
    const buffer = new Uint8Array(Number(size));
    const { bytesRead } = await file.read(buffer, 0, buffer.length, Number(offset));
    return buffer.subarray(0, bytesRead);
  },
};
const decompressHandlers = {
  zstd: (buffer, size) => decompress(buffer, new Uint8Array(Number(size))),
};
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });

const decoders = new Map();
for (const [id, schema] of reader.schemasById) {
  const definition = parse(new TextDecoder().decode(schema.data), { ros2: true });
  decoders.set(id, new MessageReader(definition));
}

// What JSON has no number for.
function exact(_, value) {
  if (typeof value === 'bigint') {
    return { bigint: String(value) };
  }
  if (typeof value === 'number' && (!Number.isFinite(value) || Object.is(value, -0))) {
    return Object.is(value, -0) ? '-0' : String(value);
  }
  return ArrayBuffer.isView(value) ? Array.from(value) : value;
}

for await (const message of reader.readMessages({ validateCrcs: true })) {
  const channel = reader.channelsById.get(message.channelId);
  const line = {
    topic: channel.topic,
    type_name: reader.schemasById.get(channel.schemaId).name,
    log_time: message.logTime,
    publish_time: message.publishTime,
    sequence: message.sequence,
    data: Buffer.from(message.data).toString('base64'),
    metadata: Object.fromEntries(channel.metadata),
    message: decoders.get(channel.schemaId).readMessage(message.data),
  };
  console.log(JSON.stringify(line, exact));
}
await file.close();
