// Asking the daemon: JSON in, JSON out; a refusal becomes an error with the daemon's own words.

export class Refused extends Error {
  constructor(public status: number, message: string) { super(message); }
}

const name = (): Record<string, string> => {
  const operator = localStorage.getItem("operator");
  return operator ? { "x-operator": operator.replace(/[^\x20-\x7e]/g, "") } : {};
};

async function ask<T>(method: string, path: string, body?: unknown): Promise<T> {
  const headers: Record<string, string> = name();
  if (body !== undefined) headers["content-type"] = "application/json";
  let answer: Response;
  try {
    answer = await fetch(`/api/v1/${path}`, { method, headers, body: body === undefined ? undefined : JSON.stringify(body) });
  } catch {
    throw new Refused(0, "the daemon does not answer; the table goes on as it was told");
  }
  if (answer.status === 204) return undefined as T;
  const said = await answer.json().catch(() => ({}));
  if (!answer.ok) throw new Refused(answer.status, said.message ?? `refused (${answer.status})`);
  return said as T;
}

export const get = <T>(path: string): Promise<T> => ask<T>("GET", path);
export const post = <T>(path: string, body?: unknown): Promise<T> => ask<T>("POST", path, body);
export const put = <T>(path: string, body: unknown): Promise<T> => ask<T>("PUT", path, body);
export const del = <T>(path: string): Promise<T> => ask<T>("DELETE", path);
export const run = (id: string): string => `runs/${encodeURIComponent(id)}`;
